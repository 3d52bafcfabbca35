"""Verify, recover and annotate run files; measured values are never changed.

`recover` writes a copy next to the original; `annotate` replaces the file after every checksum has been compared.
"""

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py

from leactl.errors import InputError
from leactl.regular_files import is_being_written
from leactl.runfile import layout, seal
from leactl.runfile.hdf5.opening import DAMAGE, damage_text, open_run_file, reading
from leactl.runfile.hdf5.space import reserve, trim
from leactl.runfile.publish import new_file, refuse_existing, replacement
from leactl.runfile.read.reader import Run
from leactl.runfile.read.stream_checks import faults_of_streams, uneven_tables, whole_rows
from leactl.runfile.summary import RECORDING, STATUSES
from leactl.runfile.write.repack import repack, text_bytes, write_table

ALL_PARTS = "values, names and attributes"  # parts of a file that checksums and seal cover together


@dataclass(frozen=True)
class Examination:
    """Result of the verification of one run file."""

    path: Path
    findings: list[str]  # what is wrong with it, one line each
    status: str = ""
    covered: str = ""  # "values", or "values, names and attributes"; empty for a file without checksums

    @property
    def summary(self) -> str:
        """One line for people: the status of a sound run, and which parts of the file are known to be unchanged."""
        status_text = self.status or "no status"
        if not self.covered:
            return f"{status_text}; no checksums: nothing tells whether it was changed"
        coverage_hint = "" if self.covered == ALL_PARTS else "; no seal: names and attributes are not covered"
        return f"{status_text}; {self.covered} are as they were closed{coverage_hint}"

    def as_json(self) -> dict[str, Any]:
        """Return the result as a JSON object."""
        covered = self.covered or None
        return {"run": str(self.path), "status": self.status, "covered": covered, "findings": self.findings}


def examine(path: Path) -> Examination:
    """Verify a run file; if it is sound, also report its status and which parts checksums and seal cover."""
    if findings := verify(path):
        return Examination(path, findings)
    with Run.open(path) as run:
        return Examination(path, [], run.status, ALL_PARTS if run.sealed else "values" if run.checked else "")


def verify(path: Path) -> list[str]:
    """Return one line for each fault of a run file; empty if it has none.

    Files of other programs have no checksums; that alone is no fault.
    """
    try:
        file, live = open_run_file(path)
    except InputError as fault:
        return fault.faults
    with file:
        try:
            findings = [
                *unfinished_findings(file, live),
                *missing_attributes(file),
                *uneven_tables(file),
            ]
            findings += faults_of_streams(file.get("streams", {}), unfinished=False)
            return [f"{path}: {finding}" for finding in [*findings, *altered_parts(file)]]
        except DAMAGE as fault:
            return [f"{path}: {damage_text(fault)}"]


def altered(path: Path) -> list[str]:
    """Return one line for each difference to the closed run; empty for a file without checksums.

    Raises
    ------
    InputError : not a run file.
    """
    file, _live = open_run_file(path)
    with file, reading(path):
        return [f"{path}: {finding}" for finding in altered_parts(file)]


def refuse_altered(paths: Iterable[Path]) -> None:
    """Raise InputError if runs differ from their state when they were closed.

    Raises
    ------
    InputError : a line for each changed value, name or attribute.
    """
    refuse_findings([finding for path in paths for finding in altered(path)])


def refuse_findings(findings: Sequence[str]) -> None:
    """Raise InputError with the findings of `altered`, if there are any."""
    if findings:
        raise InputError([f"{finding}; nothing is worked out from it" for finding in findings])


def altered_parts(file: Any) -> list[str]:
    """Return one line for each value, name or attribute that differs from the closed run."""
    return [*wrong_checksums(file), *seal.seal_findings(file)]


def unfinished_findings(file: Any, live: bool) -> list[str]:
    """Return a line if the recording did not end in order, or its status is unknown."""
    status = layout.to_python(file.attrs.get("status", ""))
    if live or status == RECORDING:
        return ["incomplete recording: still being written or left by a kill; run: leactl runs recover"]
    if status and status not in STATUSES:
        return [f"status {status!r} is none of {', '.join(STATUSES)}"]
    return []


def missing_attributes(file: Any) -> list[str]:
    """Return one line for each required attribute that the file lacks."""
    expected_names: list[tuple[str, Any, tuple[str, ...]]] = [("", file, layout.ROOT_ATTRIBUTES)]
    if "mechanical" not in layout.attributes(file.get("setup", file)):
        expected_names.append(("/setup", file.get("setup", file), ("mechanical",)))
    for hdf5_path, dataset in layout.datasets(file.get("streams", {}), "/streams"):
        if not hdf5_path.endswith("/time"):
            expected_names.append((hdf5_path, dataset, layout.CHANNEL_ATTRIBUTES))
    return [
        f"{hdf5_path or '/'}: no attribute {name!r}"
        for hdf5_path, node, names in expected_names
        for name in names
        if name not in node.attrs
    ]


def wrong_checksums(file: Any) -> list[str]:
    """Return one line for each dataset whose values do not match the checksum stored at close."""
    findings = []
    stored = {
        hdf5_path: str(layout.to_python(dataset.attrs.get("sha256", "")))
        for hdf5_path, dataset in layout.datasets(file)
    }
    unchecked = [hdf5_path for hdf5_path, expected in stored.items() if not expected]
    if unchecked and any(sha for hdf5_path, sha in stored.items() if not hdf5_path.startswith("/notes/")):
        others_text = f" and {len(unchecked) - 1} more" if len(unchecked) > 1 else ""
        findings.append(f"{unchecked[0]}{others_text}: no checksum, though other datasets have one")
    for hdf5_path, expected in stored.items():
        if not expected:
            continue
        try:
            computed = layout.digest(file[hdf5_path])
        except (OSError, RuntimeError) as fault:
            findings.append(f"{hdf5_path}: cannot be read: {' '.join(str(fault).split())}")
            continue
        if computed != expected:
            findings.append(
                f"{hdf5_path}: checksum mismatch: values give {computed[:12]}..., stored {expected[:12]}..."
            )
    return findings


def recover(path: Path) -> Path:
    """Write a clean copy of an interrupted run as `<stem>.recovered.h5`; the original stays.

    Columns are cut to the rows that all of them have; the status becomes `recovered`.

    Raises
    ------
    InputError : not a run file, one that a process still writes, a run that ended in order, or a copy that exists
        already.
    """
    target = path.with_name(f"{path.stem}.recovered.h5")
    refuse_existing(target)
    if is_being_written(path):
        raise InputError(
            f"{path}: a process still writes it; wait for the run's end, or end it by: leactl bench stop; "
            "a copy of now would lack the rest"
        )
    file, live = open_run_file(path)
    with file, reading(path):
        streams = file.get("streams", {})
        stream_faults = faults_of_streams(streams, unfinished=False)
        if not (live or stream_faults or layout.to_python(file.attrs.get("status", "")) == RECORDING):
            raise InputError(f"{path}: the recording ended in order; there is nothing to recover")
        if faults := faults_of_streams(streams, unfinished=True):
            raise InputError([f"{path}: {fault}" for fault in faults])
        with new_file(target) as clean:
            repack(
                file,
                clean,
                status="recovered",
                reason=f"recovered from {path.name}, whose recording was cut off",
                row_counts={name: whole_rows(group) for name, group in streams.items()},
                tables=recorded_tables(file),
            )
    return target


def recorded_tables(file: Any) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of `/steps` and `/events`, cut to those that every column has."""
    tables = {}
    for name, columns in layout.TABLES.items():
        group = file.get(name, {})
        columns_of_cells = [read_cells(group, column) for column in columns]
        tables[name] = [dict(zip(columns, row, strict=True)) for row in zip(*columns_of_cells, strict=False)]
    return tables


def read_cells(group: Mapping[str, Any], column: str) -> list[Any]:
    """Return the cells of one column of a table; empty if it is absent."""
    if column not in group:
        return []
    dataset = group[column]
    return layout.texts(dataset) if layout.is_text(dataset) else list(dataset[:].tolist())


def annotate(path: Path, text: str, author: str = "") -> None:
    """Add a note under `/notes`; the file is replaced in one step after every checksum has been compared.

    Raises
    ------
    InputError : an empty note, not a run file, one that is still being written, or a checksum that does not hold.
    """
    if not text.strip():
        raise InputError(f"{path}: the note is empty; say something of the run")
    amend(path, lambda file: add_note(file, text, author))


def amend(path: Path, change: Callable[[Any], None], apart_from: Sequence[str] = ()) -> None:
    """Change a copy of a closed run and replace the run by it, after all other values have been compared.

    Parameters
    ----------
    change : function that changes the open HDF5 file.
    apart_from : HDF5 paths below which values may be added or removed, besides `/notes`.

    Raises
    ------
    InputError : not a run file, one that is still being written, or a checksum that does not hold.
    """
    with Run.open(path) as run:
        if run.unfinished:
            raise InputError(f"{path}: still being written or left by a kill; close or recover it first")
    apart_from = ("/notes", *apart_from)
    checksums_before = checksums(path, apart_from)
    with replacement(path) as copy:
        shutil.copy2(path, copy)
        # a run of a newer format can be opened for writing only with "latest"; new objects get the oldest format
        with h5py.File(copy, "r+", libver=(layout.HDF5_FORMAT[0], "latest")) as file:
            change(file)
            seal.seal_additions(file, apart_from)
        trim(copy)
        if checksums(copy, apart_from) != checksums_before:
            raise InputError(f"{path}: the changed copy does not hold the same values; the file is as it was")


def add_note(file: Any, text: str, author: str) -> None:
    """Add one note to an open file."""
    table = file.get("notes", {})
    notes = [
        dict(zip(layout.NOTES, row, strict=True))
        for row in zip(*(read_cells(table, column) for column in layout.NOTES), strict=False)
    ]
    notes.append({"time": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}", "author": author, "text": text})
    if "notes" in file:
        del file["notes"]
    reserve(file, sum(text_bytes(cell) for note in notes for cell in note.values()))
    write_table(file.create_group("notes"), layout.NOTES, notes)


def checksums(path: Path, apart_from: Sequence[str] = ()) -> dict[str, str]:
    """Compute the checksum of every dataset from its values.

    Parameters
    ----------
    apart_from : HDF5 paths below which datasets are left out.

    Raises
    ------
    InputError : a checksum differs from the stored one.
    """
    excluded_prefixes = tuple(f"{hdf5_path}/" for hdf5_path in apart_from)
    file, _ = open_run_file(path)
    with file, reading(path):
        if findings := wrong_checksums(file):
            raise InputError([f"{path}: {finding}" for finding in findings])
        return {
            hdf5_path: layout.digest(item)
            for hdf5_path, item in layout.datasets(file)
            if not hdf5_path.startswith(excluded_prefixes)
        }
