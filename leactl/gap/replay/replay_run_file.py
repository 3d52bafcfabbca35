"""Write a replay as a run file: the same channels and clocks, inputs as measured, other channels simulated."""

import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl import __version__
from leactl.errors import InputError
from leactl.gap.replay import replay
from leactl.gap.replay.job import Job
from leactl.gap.replay.readings import replayed_angle
from leactl.gap.replay.unknown_inputs import unknown_samples
from leactl.gap.signals.record import Clocked, Key, Mask, read_record
from leactl.gap.signals.rig import voltage_feed
from leactl.model.nominal import read_model
from leactl.quantities import ChannelSpec
from leactl.runfile.publish import move_without_overwriting, refuse_existing
from leactl.runfile.read.reader import Run
from leactl.runfile.write.run_info import RunInfo, new_run_id
from leactl.runfile.write.writer import RunWriter

Array = npt.NDArray[np.float64]
# quantities that drive a replay, beside references and the current of the load
INPUTS = ("line_current", "ambient_temperature", "drive_enabled")


@dataclass(frozen=True)
class Simulated:
    """Summary of a written replay."""

    path: Path
    simulated: tuple[str, ...]  # channels that the model made, as "quantity of role"
    left_out: tuple[str, ...]  # channels of the run that the model does not determine
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as a document for other programs."""
        document = {"run": str(self.path), "simulated": self.simulated, "left_out": self.left_out, "notes": self.notes}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in document.items()}


def simulate(model_file: Path, run_file: Path, out: Path | None = None) -> Simulated:
    """Replay a run through a model, write the result with its inputs, by default next to the run, and return a summary.

    Where an input is missing for longer than the usual reach, the result is NaN, and a note gives the interval.

    Raises
    ------
    InputError : a file that cannot be used, a model that determines no channel of this run, an existing file at `out`,
        or a missing folder for it.
    """
    if out is not None:
        refuse_existing(out)
        if not out.parent.is_dir():
            raise InputError(f"{out}: no folder {out.parent}")
    model, document = read_model(model_file)
    job = replay(read_record(run_file), model)
    notes = tuple(dict.fromkeys(job.notes))
    replayed = replayed_channels(job)
    if not replayed:
        raise InputError([f"{model_file}: {note}" for note in notes] or [f"{model_file}: says nothing of {run_file}"])
    if job.restarts:
        notes += ("the motion starts again every second from the measured state: an angle is an integral",)
    unknown: Mask | None = None
    if job.record.fast is not None:
        unknown, interval_notes = unknown_samples(job)
        notes += tuple(interval_notes)
    with Run.open(run_file) as run:
        channels_of_run = [(name, spec) for name, specs in run.streams.items() for spec in specs if spec.quantity]
        columns: dict[str, list[tuple[ChannelSpec, Array]]] = {}
        for name, spec in channels_of_run:
            values = _column(run, name, spec, replayed, job, unknown)
            if values is not None:
                columns.setdefault(name, []).append((spec, values))
        path = _write(run, columns, document.text, out, run_file.parent)
    written_channels = {_channel_label(spec) for column in columns.values() for spec, _ in column}
    names = list(dict.fromkeys(_channel_label(spec) for _, spec in channels_of_run))
    channels_of_model = {f"{quantity} of {role}" for quantity, role in replayed}
    return Simulated(
        path,
        tuple(name for name in names if name in written_channels & channels_of_model),
        tuple(name for name in names if name not in written_channels),
        notes,
    )


def replayed_channels(job: Job) -> dict[Key, tuple[Clocked, Array]]:
    """Return every channel that a replay determines, with its clock, and the angle, which restarts with the motion."""
    replayed: dict[Key, tuple[Clocked, Array]] = {}
    for clock, channels in ((job.record.fast, job.fast), (job.record.slow, job.slow)):
        if clock is not None:
            replayed |= {key: (clock, values) for key, values in channels.items()}
    if job.angle is not None:
        replayed.setdefault(("angle", "test"), (job.clock, replayed_angle(job)))
    return replayed


def _column(
    run: Run,
    stream: str,
    spec: ChannelSpec,
    replayed: dict[Key, tuple[Clocked, Array]],
    job: Job,
    unknown: Mask | None,
) -> Array | None:
    """Return the values of one channel to write: replayed, else as measured if it is an input; None for any other.

    replayed : the channels that the model determines, with their clocks.
    unknown : samples of the fast clock at which the replay is unknown.
    """
    key = (spec.quantity, spec.role)
    if key in replayed:
        clock, values = replayed[key]
        time = run.time(stream)
        column = np.interp(time, clock.time, values)
        if unknown is not None and clock is job.record.fast:
            column[np.interp(time, clock.time, unknown.astype(np.float64)) > 0.0] = np.nan
        return column
    is_input = spec.quantity in INPUTS or spec.quantity.endswith("_reference") or key == ("q_axis_current", "load")
    fed_by_supply = key == ("q_axis_voltage", "test") and voltage_feed(job.record, job.plant.model) is not None
    if is_input or fed_by_supply or (key == ("q_axis_current", "test") and job.current is not None):
        location = spec.location or None
        return run.channel(*key, location=location).values
    return None


def _write(
    run: Run, columns: dict[str, list[tuple[ChannelSpec, Array]]], model: str, out: Path | None, default_folder: Path
) -> Path:
    """Write the run file of a replay and return its path.

    columns : channels with their values, by stream.
    model : text of the model file.
    default_folder : folder of the file where `out` is not given.
    """
    now = datetime.now(UTC)
    labels = {name: str(run.attributes.get(name, "")) for name in ("protocol", "bench", "actuator", "condition")}
    sources = {name: text for name in ("protocol", "bench") if (text := run.source(name)) is not None}
    info = RunInfo(
        run_id=new_run_id(f"{labels['protocol']}-simulated", now),
        protocol=labels["protocol"],
        bench=labels["bench"],
        actuator=labels["actuator"],
        condition=labels["condition"],
        operator="",
        simulated=True,
        mechanical=run.mechanical,
        software=f"leactl {__version__}",
        created=now.isoformat(timespec="seconds").replace("+00:00", "Z"),
        sources=sources | {"model": model},
        setup={name: value for name, value in run.setup.items() if name != "mechanical"},
        parameters=run.parameters,
    )
    run_folder = default_folder if out is None else out.parent / f".{out.name}.{secrets.token_hex(4)}"
    with RunWriter(
        run_folder, info, {name: [spec for spec, _ in column] for name, column in columns.items()}
    ) as writer:
        for name, column in columns.items():
            writer.append(name, run.time(name), np.stack([values for _, values in column], axis=1))
        for step in run.steps:
            writer.step(step.name, step.start, step.stop, step.settle, step.parameters)
    if out is None:
        return writer.path
    move_without_overwriting(writer.path, out)
    run_folder.rmdir()
    return out


def _channel_label(spec: ChannelSpec) -> str:
    """Return a channel as "quantity of role"."""
    return f"{spec.quantity} of {spec.role}"
