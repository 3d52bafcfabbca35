"""Runs of a turning shaft with open leads, from closed forms alone: flux linkages of the electrical angle."""

from dataclasses import dataclass, field

import numpy as np

from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

PAIRS = ("ab", "bc", "ca")
THIRD = 2.0 * np.pi / 3.0
KB = 0.49  # V*s/rad, q axis; sqrt(2) of it line to line
SPEED = 2.0 * np.pi


@dataclass
class OpenLeads:
    """Writes runs into a directory; `rng` makes their noise."""

    directory: object
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    count: int = 0

    def run(
        self,
        *,
        kb=KB,
        poles=41,
        speeds=(SPEED,),
        seconds=2.5,
        rate_Hz=10_000,  # noqa: N803
        noise=0.005,
        skew_s=14e-6,
        told_skew=True,
        scale_std=0.0,
        harmonics=(),
        sag=0.0,
        ripple=0.0,
        gains=(1.0, 1.0, 1.0),
        step=10.0 / 32768,
        edit=None,
        model="torque_constant: 0.49\npole_pairs: 41\nwinding: wye\n",
        enabled=False,
        with_angle=True,
        steps=True,
        counts=40_000,
    ):
        """Write a run and return its path.

        A pair's voltage is the shaft's speed times kb sqrt(2) (cos x + sum of r cos(h x + p)); `sag` is the share of
        the speed that a hold loses to its end, `ripple` its amplitude twice a wave. `edit(times, columns)` may change
        the voltages before they are rounded.
        """
        self.count += 1
        held = seconds + 0.5
        daq, loop = np.arange(len(speeds) * held * rate_Hz) / rate_Hz, np.arange(len(speeds) * held * 500) / 500
        columns = {}
        for place, name in enumerate(PAIRS):
            speed, angle = shaft(daq + place * skew_s, speeds, held, sag, ripple, poles)
            own = poles * angle - place * THIRD
            shape = np.cos(own) + sum(share * np.cos(order * own + phase) for order, share, phase in harmonics)
            volts = gains[place] * np.sqrt(2.0) * kb * speed * shape
            columns[name] = volts + noise * self.rng.standard_normal(len(daq))
        if edit is not None:
            edit(daq, columns)
        if step:
            columns = {name: step * np.round(volts / step) for name, volts in columns.items()}
        speed, angle = shaft(loop, speeds, held, sag, ripple, poles)
        count = 2.0 * np.pi / counts
        specs = {
            "loop": [
                ChannelSpec("angle", "angle", "test", "drive", dtype="f8") if with_angle else
                ChannelSpec("omega", "velocity", "load", "drive"),
                ChannelSpec("enabled", "drive_enabled", "test", "drive"),
            ],
            "daq": [
                ChannelSpec(
                    name, f"phase_voltage_{name}", "test", "daq", skew_s=place * skew_s * told_skew, scale_std=scale_std
                )
                for place, name in enumerate(PAIRS)
            ],
        }  # fmt: skip
        writer = RunWriter(self.directory, described(self.count, model), specs)
        writer.append("daq", daq, np.column_stack(list(columns.values())))
        shown = count * np.floor(angle / count) if with_angle else speed
        writer.append("loop", loop, np.column_stack([shown, np.full(len(loop), float(enabled))]))
        for number, wanted in enumerate(speeds if steps else ()):
            writer.step("hold", number * held, (number + 1) * held, 0.5, {"velocity_rad_s": wanted, "role": "load"})
        writer.close("complete")
        return writer.path


def shaft(time, speeds, held, sag, ripple, poles):
    """Speed [rad/s] and angle [rad] over time."""
    number = np.minimum((time / held).astype(int), len(speeds) - 1)
    into, wanted = time - number * held, np.array(speeds)[number]
    speed, angle = wanted * (1.0 - sag * into / held), wanted * into * (1.0 - 0.5 * sag * into / held)
    before = np.concatenate([[0.0], np.cumsum(np.array(speeds) * held * (1.0 - 0.5 * sag))])[number]
    if ripple:  # angle = mean + a sin(2 poles mean): the speed is exactly its derivative
        size = ripple / (2.0 * poles)
        mean = angle + before
        return speed * (1.0 + ripple * np.cos(2.0 * poles * mean)), mean + size * np.sin(2.0 * poles * mean)
    return speed, angle + before


def described(number, model):
    return RunInfo(
        run_id=f"20261120T101530Z-back-emf-{number:04d}",
        protocol="back-emf",
        bench="synthetic",
        actuator="a1",
        condition="design",
        operator="",
        simulated=True,
        mechanical="coupled",
        software="",
        created="2026-11-20T10:15:30Z",
        sources={"protocol": "name: x\nanalysis: back-emf\n"} | ({"model": model} if model else {}),
    )
