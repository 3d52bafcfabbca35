"""An arm on a motor that is fed with a voltage and logs no current: ramps and steps both ways, as WPILib runs them."""

from dataclasses import dataclass, field

import numpy as np

from leactl.gap.diagnose import Case
from leactl.gap.signals.record import build_record
from leactl.runfile.read.reader import Channel

RATE = 200.0  # Hz
PARTS = 10  # steps a sample
TESTS = {"slow-forward": 1.0, "slow-backward": -1.0, "fast-forward": 1.0, "fast-backward": -1.0}


@dataclass(frozen=True)
class Arm:
    """What the joint is made of, its torques in volts; `pull` is a torque [V] at an angle and a speed."""

    kS: float = 0.15  # V  # noqa: N815 (WPILib's names)
    kV: float = 1.2  # V*s/rad  # noqa: N815
    kA: float = 0.12  # V*s^2/rad  # noqa: N815
    pull: object = field(default=lambda angle, speed: 0.0 * angle)
    noise: float = 2e-4  # rad
    lag: float = 0.0  # s, of the reported velocity


def volts_of(test, time, most):
    """A ramp or a step, the one as long as the joint needs to cross its range."""
    size = 0.3 + 0.5 * time if test.startswith("slow") else np.full_like(time, most)
    return TESTS[test] * np.minimum(size, most)


def recorded(folder, arm, test, random, most=2.4, span=3.6, start=-1.6):
    """One test: the arm begins at one end of its range and is stopped at the other."""
    time = np.arange(round(12.0 * RATE)) / RATE
    volts, step = volts_of(test, time, most), 1.0 / RATE / PARTS
    angle, speed, read = start + (0.0 if TESTS[test] > 0 else span), 0.0, 0.0
    rows = []
    for value in volts.tolist():  # Python's own numbers, several times as fast here as NumPy's
        for _ in range(PARTS):
            drive = value - arm.kV * speed - float(arm.pull(angle, speed))
            ahead = speed + drive * step / arm.kA
            most_held = arm.kS * step / arm.kA
            speed = ahead - min(max(ahead, -most_held), most_held)
            angle += speed * step
            read += (speed - read) * (step / arm.lag if arm.lag > step else 1.0)
        rows.append((angle, read))
        if abs(angle - start - 0.5 * span) > 0.5 * span:
            break
    angles, speeds = np.array(rows).T
    count = len(angles)
    stamps = (1.0 + np.arange(count)) / RATE

    def channel(quantity, values, units):
        return Channel(stamps, values, quantity, "test", units, "", "", "", "", "loop")

    channels = [
        channel("q_axis_voltage", volts[:count], "V"),
        channel("angle", angles + arm.noise * random.standard_normal(count), "rad"),
        channel("velocity", speeds + 10.0 * arm.noise * random.standard_normal(count), "rad/s"),
    ]
    return build_record(folder / f"{test}.h5", test, "free", channels, {})


def logs(folder, arm, seed=1, **changes):
    """The four tests of a log."""
    random = np.random.default_rng(seed)
    return [recorded(folder, arm, test, random, **changes) for test in TESTS]


def case_of(records, model):
    """The log with stretches of each test held out."""
    kept, taken = zip(*(record.hold_out_stretches() for record in records), strict=True)
    return Case(model, list(kept), list(taken))
