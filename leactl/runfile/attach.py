"""Attach a record of another device to a closed run, as a separate stream on the run's clock, with its provenance.

The recorded values of the run do not change: the file is replaced by a copy with one more stream, after all other
values have been compared. The stream's attributes have the files' checksums, remarks on their content and the alignment
of the clocks. The new stamps are a linear function of the record's stamps, which can therefore be restored.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from leactl.driver.file_records import FileRecord, RecordClock
from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.align.alignment import NORMAL_95, Alignment, Tie, fit_alignment
from leactl.runfile.align.onsets import ties_by_onset
from leactl.runfile.align.similarity import align_by_similarity
from leactl.runfile.hdf5.space import reserve
from leactl.runfile.read.reader import Array, Run
from leactl.runfile.verify.integrity import add_note, amend
from leactl.runfile.write.repack import CHUNK_ROWS, COMPRESSION
from leactl.runfile.write.run_info import faults_of_channel

LONGEST_START_S = 0.2  # from a run's `created` to its first cycle
FEWEST_ROWS = 2  # rows of a record within the run
MOST_TEXT_BYTES = 8000  # bytes of one text: attributes of an object share 64 KiB (HDF5 file format 3.0, IV.A.2.m)


@dataclass(frozen=True)
class AlignedRecord:
    """A record with its stamps converted to the clock of a run, ready to be stored."""

    record: FileRecord
    alignment: Alignment
    time: Array  # s since the run's start
    values: Array  # (rows, channels)
    left_out: int  # number of rows before the run's start or after its end

    @property
    def uncertainty(self) -> float:
        """Half-width of the 95 % interval of the most uncertain stamp [s]."""
        device_times = (self.time[[0, -1]] - self.alignment.offset) / self.alignment.rate
        return max(self.alignment.uncertainty(float(stamp)) for stamp in device_times)

    def summary_lines(self) -> list[str]:
        """Return lines for people: remarks on the record, the alignment, its uncertainty, and the numbers of rows."""
        middle = float(np.mean((self.time[[0, -1]] - self.alignment.offset) / self.alignment.rate))
        rows_text = f"{len(self.time)} rows, {self.time[0]:.6g} to {self.time[-1]:.6g} s of the run"
        outside_text = f"; {self.left_out} rows outside the run left out" if self.left_out else ""
        uncertainty_text = f"stamps are good to {self.uncertainty:.2g} s (95 %)"
        return [*self.record.remarks, self.alignment.describe(middle), uncertainty_text, rows_text + outside_text]

    def as_json(self) -> dict[str, Any]:
        """Return the same facts as a JSON object."""
        return {
            "stream": self.record.stream,
            "rows": len(self.time),
            "rows_left_out": self.left_out,
            "told": list(self.record.remarks),
            "alignment": {
                "method": self.alignment.method,
                "offset_s": self.alignment.offset,
                "rate": self.alignment.rate,
                "uncertainty_s": self.uncertainty,
                "drift_uncertainty_ppm": self.alignment.drift_uncertainty_ppm,
                "ties": self.alignment.ties,
            },
        }


def align_record(record: FileRecord, clock: RecordClock, run: Run) -> AlignedRecord:
    """Convert a record's stamps to the clock of a run and leave out the rows outside the run.

    Raises
    ------
    InputError : the clocks cannot be aligned, or fewer than two rows lie within the run.
    """
    alignment = alignment_of(record, clock, run)
    time = alignment.on_run(record.time)
    end = max((float(run.time(name)[-1]) for name, rows in run.rows.items() if rows), default=0.0)
    is_inside = (time >= 0.0) & (time <= end)
    if is_inside.sum() < FEWEST_ROWS:
        raise InputError(
            f"{record.files[0]}: a record of another time: on the run's clock it goes from {time[0]:.6g} to"
            f" {time[-1]:.6g} s, and the run from 0 to {end:.6g} s"
        )
    return AlignedRecord(record, alignment, time[is_inside], record.values[is_inside], int(len(time) - is_inside.sum()))


def alignment_of(record: FileRecord, clock: RecordClock, run: Run) -> Alignment:
    """Align the record's clock with the run's by the method that the settings name.

    Raises
    ------
    InputError : a channel is missing, or the method does not find the offset of the clocks.
    """
    drift = 1e-6 * clock.drift_within_ppm
    if clock.wall_within_s is not None:
        offset, resolution_half_width = wall_offset(record, run)
        middle_time = 0.5 * float(record.time[-1])
        tie_sd = (clock.wall_within_s + resolution_half_width) / NORMAL_95
        return fit_alignment("both wall clocks", [Tie(middle_time, middle_time + offset, tie_sd)], drift, 0.0)
    if clock.offset_s is not None:
        tie_sd = max((clock.offset_within_s or 0.0) + 0.5 * record.resolution, 1e-9) / NORMAL_95
        return fit_alignment("a given offset", [Tie(0.0, clock.offset_s, tie_sd)], drift, 0.0)
    reference_settings = clock.estimate or clock.onset
    assert reference_settings is not None
    values = record_channel(record, reference_settings.channel)
    reference = run.channel_at(reference_settings.against)
    near_s = clock.near_s if clock.near_s is not None else expected_offset(record, run)
    channels_text = f"{reference_settings.channel} and {reference_settings.against}"
    systematic = clock.delays_within_s + 0.5 * record.resolution
    reference_channel = (reference.time, reference.values)
    try:
        if clock.estimate is not None:
            return align_by_similarity(
                (record.time, values),
                reference_channel,
                reference_settings.within_s,
                channels_text,
                near_s,
                drift,
                systematic,
            )
        assert clock.onset is not None
        ties = ties_by_onset(
            record.time,
            values,
            *reference_channel,
            clock.onset.jump,
            near_s,
            clock.onset.within_s,
            clock.onset.fit_s,
        )
    except InputError as fault:
        raise InputError(f"{record.files[0]}: {fault}") from None
    if not ties:
        raise InputError(
            f"{record.files[0]}: {clock.onset.channel} shows no onset within {clock.onset.within_s:g} s of a jump of"
            f" {clock.onset.against} by {clock.onset.jump:g} {reference.units}, at offsets around {near_s:.6g} s"
        )
    times = ", ".join(f"{tie.run_time:.3f} s" for tie in ties[:4])
    return fit_alignment(
        f"onset of {reference_settings.channel} at jumps of {reference_settings.against} ({times})",
        ties,
        drift,
        systematic,
    )


def record_channel(record: FileRecord, name: str) -> Array:
    """Return the values (n,) of one channel of the record.

    Raises
    ------
    InputError : the record has no such channel.
    """
    names = [spec.name for spec in record.channels]
    if name not in names:
        raise InputError(f"{record.files[0]}: the record has no channel {name!r}; it has {', '.join(names)}")
    return record.values[:, names.index(name)]


def wall_offset(record: FileRecord, run: Run) -> tuple[float, float]:
    """Return the offset of the clocks by their wall-clock times [s], and its uncertainty from their resolutions [s].

    The uncertainty is a half-width; it includes the time from the run's `created` to its first cycle.

    Raises
    ------
    InputError : the record has no date or no zone, or the run's `created` is no ISO 8601 time with a zone.
    """
    if record.began is None:
        message = (
            "its clock tells no day or no zone; set time.date and time.zone, or tie it by offset_s, estimate or onset"
        )
        raise InputError(f"{record.files[0]}: {message}")
    created_text = str(run.attributes.get("created", ""))
    try:
        created = datetime.fromisoformat(created_text)
    except ValueError:
        raise InputError(f"{run.path}: attribute created is {created_text!r}, no ISO 8601 moment") from None
    if created.tzinfo is None:
        raise InputError(f"{run.path}: attribute created, {created_text}, has no zone")
    resolution = 0.0 if "." in created_text else 1.0  # s; whole seconds are truncated, not rounded
    start = created.timestamp() + 0.5 * (resolution + LONGEST_START_S)
    return record.began + 0.5 * record.resolution - start, 0.5 * (resolution + LONGEST_START_S + record.resolution)


def expected_offset(record: FileRecord, run: Run) -> float:
    """Return the offset to search around [s]: that of the wall clocks if both are known, else 0."""
    try:
        return wall_offset(record, run)[0]
    except InputError:
        return 0.0


def attach(path: Path, aligned: AlignedRecord, settings: Mapping[str, Any], driver: str, replace: bool = False) -> None:
    """Store an aligned record in its run.

    Parameters
    ----------
    settings : settings with which the files were read; stored as an attribute of the stream.
    replace : replace a stream of this name that was attached before.

    Raises
    ------
    InputError : the run has a stream of this name, or channels of the same quantity, role and location; or the settings
        are too long to be stored.
    """
    record = aligned.record
    with Run.open(path) as run:
        refuse_duplicates(run, record, replace)
        checked = run.checked
    attributes = provenance(aligned, settings, driver)

    def change(file: Any) -> None:
        streams = file.require_group("streams")
        if record.stream in streams:
            del streams[record.stream]
        write_stream(streams, aligned, attributes, checked)
        names = ", ".join(source.name for source in record.files)
        note = f"stream {record.stream} attached from {names}: {aligned.alignment.describe()}"
        add_note(file, note, "leactl runs attach")

    amend(path, change, apart_from=(f"/streams/{record.stream}",))


def refuse_duplicates(run: Run, record: FileRecord, replace: bool) -> None:
    """Raise InputError if the run has the record's stream, or a channel of equal quantity, role and location."""
    faults = [
        fault for spec in record.channels for fault in faults_of_channel(f"streams/{record.stream}/{spec.name}", spec)
    ]
    if record.stream in run.streams:
        attached = run.attached(record.stream)
        if not attached:
            faults.append(f"stream {record.stream} was recorded with the run and stays; name the device otherwise")
        elif not replace:
            message = f"stream {record.stream} is attached already, from {attached.get('record_files')}"
            faults.append(f"{message}; --replace puts this record in its place")
    paths_by_identity = {
        (spec.quantity, spec.role, spec.location): f"{name}/{spec.name}"
        for name, specs in run.streams.items()
        if name != record.stream
        for spec in specs
    }
    faults += [
        f"{record.stream}/{spec.name}: same quantity, role and location as {existing_path}"
        for spec in record.channels
        if (existing_path := paths_by_identity.get((spec.quantity, spec.role, spec.location)))
    ]
    if faults:
        raise InputError([f"{run.path}: {fault}" for fault in faults])


def provenance(aligned: AlignedRecord, settings: Mapping[str, Any], driver: str) -> dict[str, str | float | int]:
    """Return the attributes of the stream: files with checksums, settings, remarks and the alignment of the clocks.

    Raises
    ------
    InputError : the settings are longer than an attribute may be; cut off, they would be no JSON.
    """
    record, alignment = aligned.record, aligned.alignment
    settings_text = json.dumps(settings, ensure_ascii=False)
    if (size := len(settings_text.encode())) > MOST_TEXT_BYTES:
        raise InputError(f"settings of {driver}: {size} bytes as JSON; {MOST_TEXT_BYTES} at most were expected")
    digests = []
    for path in record.files:
        with path.open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    digest_text = hashlib.sha256("".join(digests).encode()).hexdigest() if len(digests) > 1 else digests[0]
    return {
        "record_files": cut_to_bytes(", ".join(path.name for path in record.files)),
        "record_sha256": digest_text,  # of several files: digest of their concatenated hexadecimal digests
        "record_driver": driver,
        "record_settings": settings_text,
        "record_told": cut_to_bytes("\n".join(aligned.summary_lines())),
        "record_rows_left_out": aligned.left_out,
        "alignment_method": alignment.method,
        "alignment_offset_s": alignment.offset,
        "alignment_rate": alignment.rate,
        "alignment_uncertainty_s": aligned.uncertainty,
        "alignment_drift_uncertainty_ppm": alignment.drift_uncertainty_ppm,
        "alignment_ties": alignment.ties,
    }


def cut_to_bytes(text: str) -> str:
    """Return the text cut to the `MOST_TEXT_BYTES` bytes that its attribute may have."""
    return text.encode()[:MOST_TEXT_BYTES].decode("utf-8", "ignore")


def write_stream(
    streams: Any, aligned: AlignedRecord, attributes: Mapping[str, str | float | int], checked: bool
) -> None:
    """Write the stream compressed, as the streams of a closed run are; `checked` adds a checksum to each dataset."""
    record, rows = aligned.record, len(aligned.time)
    reserve(streams.file, 8 * rows * (1 + len(record.channels)) + (1 << 16))
    storage = {"shape": (rows,), "maxshape": (None,), "chunks": (min(CHUNK_ROWS, rows),), **COMPRESSION}
    group = layout.create_stream(streams, record.stream, list(record.channels), **storage)
    group["time"][:] = aligned.time
    for column, spec in enumerate(record.channels):
        group[spec.name][:] = aligned.values[:, column]
    for dataset in group.values():
        if checked:
            dataset.attrs["sha256"] = layout.digest(dataset)
    for name, value in attributes.items():
        group.attrs[name] = layout.storable(value) if isinstance(value, str) else value
