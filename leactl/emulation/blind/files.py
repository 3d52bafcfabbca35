"""Write a case: ten run files, the nominal model to compare them with, and the entry of the key."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from leactl import __version__
from leactl.emulation.blind.bases import nominal_text
from leactl.emulation.blind.draws import BlindCase, RunDraw
from leactl.emulation.plant.stepped.heating import HeatedRun
from leactl.emulation.plant.stepped.lanes import Array
from leactl.emulation.plant.stepped.sensors import Sensors
from leactl.emulation.plant.stepped.simulation import DriveReferences, DriveSignals
from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunInfo, RunWriter

CREATED = "2026-01-01T00:00:00Z"  # of every case: files depend on the seed alone, and no date tells a batch
LOOP_CHANNELS = {
    "current_reference": ChannelSpec("current_reference", "q_axis_current_reference", "test", "drive_test"),
    "current": ChannelSpec("current", "q_axis_current", "test", "drive_test", sampling="mean"),
    "voltage": ChannelSpec("voltage", "q_axis_voltage", "test", "drive_test", sampling="mean"),
    "velocity": ChannelSpec("velocity", "velocity", "test", "drive_test"),
    "angle": ChannelSpec("angle", "angle", "test", "drive_test", dtype="f8"),
    "bus_voltage": ChannelSpec("bus_voltage", "bus_voltage", "bench", "drive_test"),
    "torque": ChannelSpec("torque", "torque", "test", "torque_sensor"),
    "load_current": ChannelSpec("load_current", "q_axis_current", "load", "drive_load"),
    "load_velocity": ChannelSpec("load_velocity", "velocity", "load", "drive_load"),
}
CAMERA_CHANNELS = {
    "winding": ChannelSpec("winding", "winding_temperature", "test", "camera"),
    "housing": ChannelSpec("housing", "housing_temperature", "test", "camera"),
    "ambient": ChannelSpec("ambient", "ambient_temperature", "bench", "camera"),
}
SUPPLY_CHANNELS = {
    "line_current": ChannelSpec("line_current", "line_current", "test", "supply"),
    "line_voltage": ChannelSpec("line_voltage", "line_voltage", "test", "supply"),
}


def write_model(folder: Path, case: BlindCase) -> None:
    """Write the nominal model of a case as `nominal.yaml`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "nominal.yaml").write_text(nominal_text(case.base), encoding="utf-8")


def write_moving(folder: Path, case: BlindCase, run: RunDraw, signals: DriveSignals) -> None:
    """Write a run in which the drives were on."""
    sensors = Sensors(run.lane, case.spread, run.seed)
    loop = sensors.loop(signals)
    specs = dict(LOOP_CHANNELS)
    program = run.program
    if isinstance(program, DriveReferences) and program.velocity is not None:
        drive = f"drive_{program.servo}"
        specs["velocity_reference"] = ChannelSpec("velocity_reference", "velocity_reference", program.servo, drive)
        loop["velocity_reference"] = np.asarray(program.velocity)
    _write(folder, case, run, {"loop": (specs, loop), "camera": (CAMERA_CHANNELS, sensors.camera(signals))})


def write_heated(folder: Path, case: BlindCase, run: RunDraw, heated: HeatedRun) -> None:
    """Write a run in which direct current heated the windings."""
    camera, supply = Sensors(run.lane, case.spread, run.seed).heated(heated)
    _write(folder, case, run, {"camera": (CAMERA_CHANNELS, camera), "supply": (SUPPLY_CHANNELS, supply)})


def _write(
    folder: Path, case: BlindCase, run: RunDraw, streams: dict[str, tuple[dict[str, ChannelSpec], dict[str, Array]]]
) -> None:
    """Write a run file; `streams` has the channel specifications and the channels of each stream."""
    info = RunInfo(
        run_id=f"{case.name}-{run.name}",
        protocol=run.kind,
        bench="withheld",
        actuator="bench-unit",
        condition="design",
        operator="",
        simulated=True,
        mechanical=run.lane.setup,
        software=f"leactl {__version__}",
        created=CREATED,
        sources={"model": nominal_text(case.base)},
    )
    specs_by_stream = {
        stream: [spec for name, spec in specs.items() if name in channels]
        for stream, (specs, channels) in streams.items()
    }
    with RunWriter(folder, info, specs_by_stream) as writer:
        for stream, (_, channels) in streams.items():
            block = np.column_stack([channels[spec.name] for spec in specs_by_stream[stream]])
            writer.append(stream, channels["time"], block)
    writer.path.rename(folder / f"{run.name}.h5")


def entry(case: BlindCase) -> dict[str, Any]:
    """Return a case's entry of the key; effects outside the vocabulary are `unknown`, with names in `unlisted`."""
    known_effects = [planted for planted in case.effects if case.kind != "unknown"]
    return {
        "kind": case.kind,
        "effects": ["unknown"] if case.kind == "unknown" else [planted.name for planted in known_effects],
        "unlisted": [planted.name for planted in case.effects if case.kind == "unknown"],
        "strength": case.effects[0].strength if case.effects else None,
        "parameters": {planted.name: dict(planted.parameters) for planted in case.effects},
        "true_base": _true_base(case),
    }


def _true_base(case: BlindCase) -> dict[str, float]:
    """Return the true parameters by their names in the model file; names of nested parameters have dots."""
    base = case.base
    test: dict[str, Any] = asdict(base.test)
    thermal = test.pop("thermal")
    motor_values = {name: value for name, value in test.items() if isinstance(value, float)}
    return {
        **motor_values,
        **{f"thermal.{name}": value for name, value in thermal.items()},
        "bench.shaft_stiffness": base.bench.shaft_stiffness,
        "load.viscous_damping": base.load.viscous_damping,
        "load.coulomb_friction": base.load.coulomb_friction,
        "ambient_temperature": base.bench.ambient_temperature,
    }
