"""Write a case of a drawn machine: its logged runs, the nominal model, and the entry of the key."""

from pathlib import Path
from typing import Any

import numpy as np

from leactl import __version__
from leactl.joints.effects import DrawnEffect, indistinguishable_effects
from leactl.joints.machine import Specimen, nominal_text
from leactl.joints.run import Array, JointRun, JointSignals
from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

CREATION_TIME = "2026-01-01T00:00:00Z"  # constant, so that a seed gives the same files and no date reveals a batch
QUANTITIES = {  # quantity and sampling of each channel
    "current_reference": ("q_axis_current_reference", "instant"),
    "current": ("q_axis_current", "mean"),
    "velocity_reference": ("velocity_reference", "instant"),
    "velocity": ("velocity", "instant"),
    "angle": ("angle", "instant"),
}


def write_run(folder: Path, case: str, run: JointRun, signals: JointSignals) -> None:
    """Write the run file of a run with the channels that the machine logs, with noise and rounding."""
    machine = run.specimen.machine
    columns = {name: values for name, values in logged_columns(run, signals).items() if name in machine.channels}
    specs = [
        ChannelSpec(
            name,
            QUANTITIES[name][0],
            "test",
            "drive",
            sampling=QUANTITIES[name][1] if machine.sampling else "",
            dtype="f8" if name == "angle" else "f4",
        )
        for name in columns
    ]
    info = RunInfo(
        run_id=f"{case}-{run.name}",
        protocol=run.protocol,
        bench="withheld",
        actuator=machine.kind,
        condition="design",
        operator="",
        simulated=True,
        mechanical="free",
        software=f"leactl {__version__}",
        created=CREATION_TIME,
        sources={"model": nominal_text(machine)},
    )
    sample_count = len(signals.angle)
    with RunWriter(folder, info, {"loop": specs}) as writer:
        writer.append("loop", np.arange(1, sample_count + 1) / machine.rate, np.column_stack(list(columns.values())))
    writer.path.rename(folder / f"{run.name}.h5")


def logged_columns(run: JointRun, signals: JointSignals) -> dict[str, Array]:
    """Return the channels that a log may have, by name, with noise and rounding."""
    machine, draw = run.specimen.machine, np.random.default_rng([run.seed, 2])
    sample_count, reference = len(signals.angle), signals.reference
    columns = {
        "current_reference": reference if run.log.reference_before else np.append(reference[1:], reference[-1]),
        "current": signals.current + machine.current_noise * draw.standard_normal(sample_count),
        "velocity": signals.velocity + machine.velocity_noise * draw.standard_normal(sample_count),
        "angle": np.rint(signals.angle / machine.count) * machine.count,
    }
    if run.program.velocity is not None:
        columns["velocity_reference"] = run.program.velocity
    return columns


def key_entry(
    specimen: Specimen, kind: str, effects: tuple[DrawnEffect, ...], strength: str | None, machine: str, simulator: str
) -> dict[str, Any]:
    """Return the key's entry for a case; effects outside the vocabulary count as `unknown`."""
    is_outside_vocabulary = kind == "unknown"
    names = [drawn.name for drawn in effects]
    return {
        "kind": kind,
        "effects": ["unknown"] if is_outside_vocabulary else names,
        "unlisted": names if is_outside_vocabulary else [],
        "strength": strength,
        "parameters": {drawn.name: dict(drawn.parameters) for drawn in effects},
        "true_base": specimen.true_base(),
        "alike": {name: indistinguishable_effects(name) for name in names if indistinguishable_effects(name)},
        "machine": machine,
        "simulator": simulator,
        "ratios_to": "torque_constant",  # free runs without torque or voltage only show torques as currents
    }
