"""The same bench in another size: torque x a, current x b, time x s, and all else as physics has it; angles stay."""

import re

import numpy as np
import yaml

from leactl.runfile.read.reader import Run
from leactl.runfile.write.writer import RunInfo, RunWriter

SIZES = {"larger": (20.0, 2.0, 1.6), "smaller": (0.02, 0.4, 0.5)}
KEYS = {
    "_A": "A",
    "_rad_s": "rad/s",
    "_Hz": "Hz",
    "_s": "s",
    "_N_m": "N*m",
    "_Nm": "N*m",
    "_V": "V",
    "_kg": "N*m",
}  # weights at an arm of one length
MODEL = {
    "torque_constant": "N*m/A",
    "back_emf_constant": "N*m/A",
    "rotor_inertia": "N*m*s^2/rad",
    "viscous_damping": "N*m*s/rad",
    "coulomb_friction": "N*m",
    "phase_resistance": "ohm",
    "phase_inductance": "H",
}


def factor(units, size):
    """By what a number in these units grows."""
    torque, current, time = size
    base = {"A": current, "N*m": torque, "N": torque, "s": time, "Hz": 1.0 / time, "V": torque / (current * time)}
    base |= {"W": torque / time, "ohm": torque / (current**2 * time), "H": torque / current**2}
    base |= {"kg": torque * time**2, "J": torque}  # the former of an inertia, in kg*m^2
    found, sign = 1.0, 1
    for part in re.split(r"(/)", units):
        if part == "/":
            sign = -1
            continue
        for match in re.findall(r"N\*m|[A-Za-z]+(?:\^\d)?", part):
            name, _, power = match.partition("^")
            found *= base.get(name, 1.0) ** (sign * int(power or 1))
    return found


def rescaled(path, size, folder):
    """Write the run of a bench of another size and return its path."""
    with Run.open(path) as run:
        sources = {name: text for name in ("protocol", "model") if (text := run.source(name)) is not None}
        model = yaml.safe_load(sources.get("model", "{}")) or {}
        model |= {name: value * factor(MODEL[name], size) for name, value in model.items() if name in MODEL}
        sources["model"] = yaml.safe_dump(model)
        about = {name: str(run.attributes.get(name, "")) for name in ("protocol", "actuator", "condition", "created")}
        folder.mkdir(exist_ok=True)
        info = RunInfo(
            run_id=path.stem, bench="", operator="", simulated=True, mechanical=run.mechanical, software="",
            sources=sources, **about,
        )  # fmt: skip
        writer = RunWriter(
            folder, info, {name: [s._replace(dtype="f8") for s in ss] for name, ss in run.streams.items()}
        )
        time = size[2]
        for name, specs in run.streams.items():
            block = [run.channel_at(f"{name}/{spec.name}").values * factor(spec.units, size) for spec in specs]
            writer.append(name, run.time(name) * time, np.column_stack(block))
        for step in run.steps:
            told = {key: value * factor(unit_of(key), size) if number(value) else value
                    for key, value in step.parameters.items()}  # fmt: skip
            writer.step(step.name, step.start * time, step.stop * time, step.settle * time, told)
        writer.close("complete")
    return writer.path


def number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def unit_of(key):
    return next((unit for end, unit in sorted(KEYS.items(), key=lambda pair: -len(pair[0])) if key.endswith(end)), "1")
