"""A foreign record joins a closed run as a stream of its own, on the run's clock, with where it came from.

Nothing that the run holds is changed: the file is replaced by a copy with one stream more, once all other values have
proved the same. The stream's attributes keep the files' checksums, what was found in them and how the clocks were tied;
the stamps are a straight line of the record's own, so that those can be had back.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from leactl.driver.batch import FileRecord, RecordClock
from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.align.alignment import NORMAL_95, Alignment, Tie, by_likeness, tied
from leactl.runfile.align.onsets import ties_by_onset
from leactl.runfile.hdf5.space import reserve
from leactl.runfile.read.reader import Array, Run
from leactl.runfile.verify.integrity import add_note, amend
from leactl.runfile.write.description import faults_of_channel
from leactl.runfile.write.repack import CHUNK_ROWS, COMPRESSION

START_S = 0.2  # by which the first cycle may follow the moment that a run file calls its creation
FEWEST_ROWS = 2
MOST_TOLD = 8000  # bytes: attributes of an object share 64 KiB (HDF5 file format 3.0, IV.A.2.m)


@dataclass(frozen=True)
class AlignedRecord:
    """A record on the clock of a run, ready to be stored."""

    record: FileRecord
    alignment: Alignment
    time: Array  # s since the run's start
    values: Array  # (rows, channels)
    left_out: int  # rows before the run's start or after its end

    @property
    def uncertainty(self) -> float:
        """Half the 95 % interval of the stamp that is known worst [s]."""
        own = (self.time[[0, -1]] - self.alignment.offset) / self.alignment.rate
        return max(self.alignment.uncertainty(float(stamp)) for stamp in own)

    def told(self) -> list[str]:
        """What a person should know of it, one line each."""
        middle = float(np.mean((self.time[[0, -1]] - self.alignment.offset) / self.alignment.rate))
        rows = f"{len(self.time)} rows, {self.time[0]:.6g} to {self.time[-1]:.6g} s of the run"
        outside = f"; {self.left_out} rows outside the run left out" if self.left_out else ""
        worst = f"stamps are good to {self.uncertainty:.2g} s (95 %)"
        return [*self.record.told, self.alignment.told(middle), worst, rows + outside]

    def as_json(self) -> dict[str, Any]:
        """The same for scripts."""
        return {
            "stream": self.record.stream,
            "rows": len(self.time),
            "rows_left_out": self.left_out,
            "told": list(self.record.told),
            "alignment": {
                "method": self.alignment.method,
                "offset_s": self.alignment.offset,
                "rate": self.alignment.rate,
                "uncertainty_s": self.uncertainty,
                "drift_uncertainty_ppm": self.alignment.drift_uncertainty_ppm,
                "ties": self.alignment.ties,
            },
        }


def join(record: FileRecord, clock: RecordClock, run: Run) -> AlignedRecord:
    """Put a record on the clock of a run, and leave out what lies outside it.

    Raises
    ------
    InputError : clocks that cannot be tied, or a record of another time.
    """
    alignment = aligned(record, clock, run)
    time = alignment.on_run(record.time)
    end = max((float(run.time(name)[-1]) for name, rows in run.rows.items() if rows), default=0.0)
    inside = (time >= 0.0) & (time <= end)
    if inside.sum() < FEWEST_ROWS:
        raise InputError(
            f"{record.files[0]}: a record of another time: on the run's clock it goes from {time[0]:.6g} to"
            f" {time[-1]:.6g} s, and the run from 0 to {end:.6g} s"
        )
    return AlignedRecord(record, alignment, time[inside], record.values[inside], int(len(time) - inside.sum()))


def aligned(record: FileRecord, clock: RecordClock, run: Run) -> Alignment:
    """Tie the record's clock to the run's in the way that the settings ask for."""
    drift = 1e-6 * clock.drift_within_ppm
    if clock.wall_within_s is not None:
        offset, within = wall_offset(record, run)
        middle = 0.5 * float(record.time[-1])
        sd = (clock.wall_within_s + within) / NORMAL_95
        return tied("both wall clocks", [Tie(middle, middle + offset, sd)], drift, 0.0)
    if clock.offset_s is not None:
        sd = max((clock.offset_within_s or 0.0) + 0.5 * record.resolution, 1e-9) / NORMAL_95
        return tied("a given offset", [Tie(0.0, clock.offset_s, sd)], drift, 0.0)
    wanted = clock.estimate or clock.onset
    assert wanted is not None
    own = own_channel(record, wanted.channel)
    reference = run.channel_at(wanted.against)
    near = clock.near_s if clock.near_s is not None else likely_offset(record, run)
    what = f"{wanted.channel} and {wanted.against}"
    systematic = clock.delays_within_s + 0.5 * record.resolution
    there = (reference.time, reference.values)
    try:
        if clock.estimate is not None:
            return by_likeness((record.time, own), there, wanted.within_s, what, near, drift, systematic)
        assert clock.onset is not None
        ties = ties_by_onset(record.time, own, *there, clock.onset.jump, near, clock.onset.within_s, clock.onset.fit_s)
    except InputError as fault:
        raise InputError(f"{record.files[0]}: {fault}") from None
    if not ties:
        raise InputError(
            f"{record.files[0]}: {wanted.channel} shows no onset within {wanted.within_s:g} s of a jump of"
            f" {wanted.against} by {clock.onset.jump:g} {reference.units}, at offsets around {near:.6g} s"
        )
    times = ", ".join(f"{tie.run:.3f} s" for tie in ties[:4])
    return tied(f"onset of {wanted.channel} at jumps of {wanted.against} ({times})", ties, drift, systematic)


def own_channel(record: FileRecord, name: str) -> Array:
    """Values of one channel of the record."""
    names = [spec.name for spec in record.channels]
    if name not in names:
        raise InputError(f"{record.files[0]}: the record has no channel {name!r}; it has {', '.join(names)}")
    return record.values[:, names.index(name)]


def wall_offset(record: FileRecord, run: Run) -> tuple[float, float]:
    """Offset by what both clocks say the time of day is, and how far both may be off by how they are written.

    Raises
    ------
    InputError : one of them does not tell the moment.
    """
    if record.began is None:
        told = (
            "its clock tells no day or no zone; set time.date and time.zone, or tie it by offset_s, estimate or onset"
        )
        raise InputError(f"{record.files[0]}: {told}")
    text = str(run.attributes.get("created", ""))
    try:
        created = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"{run.path}: attribute created is {text!r}, no ISO 8601 moment") from None
    if created.tzinfo is None:
        raise InputError(f"{run.path}: attribute created, {text}, has no zone")
    cut = 0.0 if "." in text else 1.0  # whole seconds are cut, not rounded
    start = created.timestamp() + 0.5 * (cut + START_S)
    return record.began + 0.5 * record.resolution - start, 0.5 * (cut + START_S + record.resolution)


def likely_offset(record: FileRecord, run: Run) -> float:
    """Where to look for an offset: by the wall clocks where both tell, else as if both had begun together."""
    try:
        return wall_offset(record, run)[0]
    except InputError:
        return 0.0


def attach(path: Path, joined: AlignedRecord, settings: Mapping[str, Any], driver: str, replace: bool = False) -> None:
    """Store a record in its run.

    Parameters
    ----------
    settings : what the files were read with; kept beside the data.
    replace : an attached stream of this name gives way to this one.

    Raises
    ------
    InputError : the run has a stream of this name, or the same quantities at the same places.
    """
    record = joined.record
    with Run.open(path) as run:
        refuse_taken(run, record, replace)
        checked = run.checked
    attributes = provenance(joined, settings, driver)

    def change(file: Any) -> None:
        streams = file.require_group("streams")
        if record.stream in streams:
            del streams[record.stream]
        write_stream(streams, joined, attributes, checked)
        names = ", ".join(source.name for source in record.files)
        note = f"stream {record.stream} attached from {names}: {joined.alignment.told()}"
        add_note(file, note, "leactl runs attach")

    amend(path, change, apart_from=(f"/streams/{record.stream}",))


def refuse_taken(run: Run, record: FileRecord, replace: bool) -> None:
    """Refuse a record whose stream or channels the run has already."""
    faults = [
        fault for spec in record.channels for fault in faults_of_channel(f"streams/{record.stream}/{spec.name}", spec)
    ]
    if record.stream in run.streams:
        known = run.attached(record.stream)
        if not known:
            faults.append(f"stream {record.stream} was recorded with the run and stays; name the device otherwise")
        elif not replace:
            taken = f"stream {record.stream} is attached already, from {known.get('record_files')}"
            faults.append(f"{taken}; --replace puts this record in its place")
    held = {
        (spec.quantity, spec.role, spec.location): f"{name}/{spec.name}"
        for name, specs in run.streams.items()
        if name != record.stream
        for spec in specs
    }
    faults += [
        f"{record.stream}/{spec.name}: same quantity, role and location as {holder}"
        for spec in record.channels
        if (holder := held.get((spec.quantity, spec.role, spec.location)))
    ]
    if faults:
        raise InputError([f"{run.path}: {fault}" for fault in faults])


def provenance(joined: AlignedRecord, settings: Mapping[str, Any], driver: str) -> dict[str, str | float | int]:
    """What is kept beside the data: files, findings and the tie of the clocks."""
    record, alignment = joined.record, joined.alignment
    digests = []
    for path in record.files:
        with path.open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    many = hashlib.sha256("".join(digests).encode()).hexdigest() if len(digests) > 1 else digests[0]
    return {
        "record_files": ", ".join(path.name for path in record.files)[:MOST_TOLD],
        "record_sha256": many,  # of several files: of their checksums one after the other
        "record_driver": driver,
        "record_settings": json.dumps(settings, ensure_ascii=False)[:MOST_TOLD],
        "record_told": "\n".join(joined.told()).encode()[:MOST_TOLD].decode("utf-8", "ignore"),
        "record_rows_left_out": joined.left_out,
        "alignment_method": alignment.method,
        "alignment_offset_s": alignment.offset,
        "alignment_rate": alignment.rate,
        "alignment_uncertainty_s": joined.uncertainty,
        "alignment_drift_uncertainty_ppm": alignment.drift_uncertainty_ppm,
        "alignment_ties": alignment.ties,
    }


def write_stream(
    streams: Any, joined: AlignedRecord, attributes: Mapping[str, str | float | int], checked: bool
) -> None:
    """Write the stream in its lasting form."""
    record, rows = joined.record, len(joined.time)
    reserve(streams.file, 8 * rows * (1 + len(record.channels)) + (1 << 16))
    storage = {"shape": (rows,), "maxshape": (None,), "chunks": (min(CHUNK_ROWS, rows),), **COMPRESSION}
    group = layout.create_stream(streams, record.stream, list(record.channels), **storage)
    group["time"][:] = joined.time
    for place, spec in enumerate(record.channels):
        group[spec.name][:] = joined.values[:, place]
    for dataset in group.values():
        if checked:
            dataset.attrs["sha256"] = layout.digest(dataset)
    for name, value in attributes.items():
        group.attrs[name] = layout.storable(value) if isinstance(value, str) else value
