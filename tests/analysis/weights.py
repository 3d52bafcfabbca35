"""Runs of dead weights on a torque sensor whose errors are known."""

import numpy as np

from leactl.analysis.experiments.torque_sensor_calibration import GRAVITY_OF_HOLDS

MASSES, ARM = (0.7, 1.4, 2.1, 2.8), 0.5
GRAVITY = 9.81
KNOWN_STDS = {"gravity_std": 1e-4, "mass_relative_std": 1e-5, "arm_std_m": 5e-6}
HOLD_S, RATE = 2.0, 10


def weighed(bench, *, gain=1.0, zero=0.02, bend=0.0, hysteresis=0.0, drift=0.0, step=0.0, noise=0.0, trials=3,
            signs=(1, -1), masses=MASSES, falling=True, scatter=0.0, arm_m=ARM, off=0.0, hold_s=HOLD_S, rate_Hz=RATE,  # noqa: N803
            edit=None):  # fmt: skip
    """A run of weights at 9.81 m/s^2: `bend` [N*m] at the top, `hysteresis` the loop's width, `drift` by the end.

    `off` is by what share the torque of the weights is more than what the run tells.
    """
    order = [(0.0, "rising")] + [(mass, "rising") for mass in masses]
    order += [(mass, "falling") for mass in (*masses[-2::-1], 0.0)] if falling else []
    holds = [(sign * mass, way) for sign in signs for _ in range(trials) for mass, way in order]
    mass = np.array([one for one, _ in holds])
    true = mass * GRAVITY * ARM * (1.0 + off)
    loop = np.array([-0.5 if way == "rising" else 0.5 for _, way in holds]) * hysteresis
    loop *= np.sign(true) * (np.abs(mass) > 0) * (np.abs(mass) < max(masses))
    reading = gain * (true + bend * (true / true.max()) ** 2 + loop) + zero + drift * np.linspace(0, 1, len(holds))
    reading = reading + bench.rng.normal(0.0, scatter, len(holds))
    column = np.repeat(reading, round(hold_s * rate_Hz))
    columns = {"torque": column + bench.rng.normal(0.0, noise, len(column))}
    steps = [
        ("hold", k * hold_s, (k + 1) * hold_s, 0.25 * hold_s,
         {"weight_Nm": kg * GRAVITY_OF_HOLDS * ARM, "arm_m": arm_m, "role": "bench", "direction": way})
        for k, (kg, way) in enumerate(holds)
    ]  # fmt: skip
    if edit is not None:
        edit(columns)
    time = np.arange(len(column)) / rate_Hz
    resolution = {"torque": step} if step else {}
    return bench.write("torque-sensor-calibration", time, columns, steps, mechanical="free", resolution=resolution)
