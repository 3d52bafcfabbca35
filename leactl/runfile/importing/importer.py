"""Import recordings of other programs: a CSV, MAT, JSON or other file and a mapping file in, run files out.

All sources are read, converted and checked before the first file is written. A file is written whole or not at all, and
none is overwritten.
"""

import glob
import hashlib
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from leactl import __version__, yamlfile
from leactl.errors import InputError
from leactl.runfile.importing.checks import implausible_values, notes_on_gaps, notes_on_units
from leactl.runfile.importing.joints import ALL, asks_for_joints, for_joint, joints_of
from leactl.runfile.importing.mapping import PLACEHOLDER, FieldOf, Mapping, as_label
from leactl.runfile.importing.parts import split_recording
from leactl.runfile.importing.sources.registry import is_log, names, open_source
from leactl.runfile.importing.sources.source import LogSource, MissingColumn, SourceRequest, WantedColumn
from leactl.runfile.importing.steps import ImportedStep, steps_of
from leactl.runfile.importing.streams import Stream, build_streams, number_value
from leactl.runfile.publish import move_without_overwriting, refuse_existing
from leactl.runfile.write.run_info import RunInfo, faults_of
from leactl.runfile.write.writer import RunWriter

DIGEST_DIGITS = 8  # of the source's SHA-256, in the `run_id` of an imported run


@dataclass
class ImportedRun:
    """A run that is ready to be written."""

    info: RunInfo
    streams: dict[str, Stream]
    steps: list[ImportedStep]
    origin: str  # the source and the mapping
    notes: list[str]  # possible errors that a person should check, each with the source's name
    name: str  # of its file, without `.h5`


def import_runs(sources: Sequence[str], mapping_path: Path, out: Path, joints: Sequence[str] = ()) -> list[Path]:
    """Import every source under one mapping into the directory `out`, as `<source>.h5` or `<source>-<part>.h5`.

    Returns
    -------
    The files written, in the order of the sources.

    Raises
    ------
    InputError : a fault in the mapping or in a source, one line each, or a file that exists already.
    """
    return write_runs(read_runs(sources, mapping_path, joints), out)


def read_runs(sources: Sequence[str], mapping_path: Path, joints: Sequence[str] = ()) -> list[ImportedRun]:
    """Read every source under one mapping into runs that are ready to be written.

    Parameters
    ----------
    sources : paths, or patterns such as `logs/*.json`.
    joints : names that replace `{joint}` in the mapping, one run each, or `all`; empty: those of the mapping.

    Raises
    ------
    InputError : a fault in the mapping or in a source, one line each.
    """
    return read_by_mapping(sources, yamlfile.load(mapping_path), joints)


def read_by_mapping(
    sources: Sequence[str], document: yamlfile.Document, joints: Sequence[str] = ()
) -> list[ImportedRun]:
    """Read every source by a mapping document that is already loaded; otherwise as `read_runs`."""
    mapping = document.validate(Mapping)
    if mapping.format is not None and mapping.format not in names():
        message = f"{mapping.format!r} is no format; one of {', '.join(names())} was expected"
        raise InputError(document.fault(("format",), message))
    if joints:
        mapping = mapping.model_copy(update={"joints": ALL if ALL in joints else tuple(dict.fromkeys(joints))})
    runs: list[ImportedRun] = []
    faults: list[str] = []
    for path in expand_patterns(sources):
        try:
            runs += read_source(path, mapping, document)
        except InputError as error:
            faults += [line for line in error.faults if line not in faults]
    file_names = [run.name for run in runs]
    faults += [
        f"{name}.h5: several sources make this file; import them into different folders"
        for name in duplicates(file_names)
    ]
    if faults:
        raise InputError(faults)
    return runs


def duplicates(names: Sequence[str]) -> list[str]:
    """Return the names that occur more than once, sorted."""
    return sorted({name for name in names if names.count(name) > 1})


def expand_patterns(sources: Sequence[str]) -> list[Path]:
    """Expand paths and patterns to files, each listed once.

    Raises
    ------
    InputError : a path or pattern without a file, or a folder that no format recognises.
    """
    paths: list[Path] = []
    for text in sources:
        if is_log(Path(text)):
            matches = [text]
        elif Path(text).is_dir():
            raise InputError(f"{text}: a directory; name its files, such as '{text.rstrip('/')}/*.csv'")
        else:
            matches = sorted(m for m in glob.glob(text, recursive=True) if is_log(Path(m)))  # noqa: PTH207 (a text, not a folder)
        if not matches:
            exists = Path(text).exists()
            raise InputError(f"{text}: {'a regular file was expected; this is none' if exists else 'no such file'}")
        paths += [Path(match) for match in matches if Path(match) not in paths]
    return paths


def read_source(path: Path, mapping: Mapping, document: yamlfile.Document) -> list[ImportedRun]:
    """Read one source into one run or several, as its mapping says.

    Raises
    ------
    InputError : all faults of the source, one line each.
    """
    mappings = mappings_by_joint(path, mapping, document)
    columns = [column for joint_mapping, _ in mappings.values() for column in wanted_columns(joint_mapping)]
    labels = [column for joint_mapping, _ in mappings.values() for column in label_columns(joint_mapping)]
    source = open_source(path, mapping.format, SourceRequest(columns, labels, mapping.csv))
    runs: list[ImportedRun] = []
    faults: list[str] = []
    for joint, (joint_mapping, joint_document) in mappings.items():
        try:
            runs += read_joint(source, joint, joint_mapping, joint_document)
        except InputError as error:
            faults += [line for line in error.faults if line not in faults]
    if faults:
        raise InputError(faults)
    return runs


def mappings_by_joint(
    path: Path, mapping: Mapping, document: yamlfile.Document
) -> dict[str, tuple[Mapping, yamlfile.Document]]:
    """Return mapping and document of each joint by its name; one entry with the name "" if `{joint}` is not used.

    Raises
    ------
    InputError : joints are given and no path has `{joint}`, or a path has it and no joints are given.
    """
    if not asks_for_joints(document):
        if mapping.joints:
            message = f"joints are asked for, and {PLACEHOLDER} stands in no path of the mapping"
            raise InputError(document.fault(("joints",), message))
        return {"": (mapping, document)}
    joints = mapping.joints
    if joints == ALL or not joints:
        tables = open_source(path, mapping.format, SourceRequest(None, csv=mapping.csv)).tables()
        source_joints = joints_of(path, mapping, tables, document)
        if not joints:
            message = (
                f"{PLACEHOLDER} stands in the mapping; give joints: or --joint as all or some of"
                f" {', '.join(source_joints)}"
            )
            raise InputError(document.fault(("joints",), message))
        joints = tuple(source_joints)
    return {joint: for_joint(document, joint) for joint in joints}


def read_joint(source: LogSource, joint: str, mapping: Mapping, document: yamlfile.Document) -> list[ImportedRun]:
    """Read the runs of one joint, or of a source without joints.

    Raises
    ------
    InputError : all faults of the joint's streams, parts and descriptions.
    """
    streams = build_streams(source, mapping, document)
    implausible = [
        f"{source.path}: {line}" for name, stream in streams.items() for line in implausible_values(name, stream)
    ]
    if implausible:
        raise InputError(implausible)
    remarks = (*source.remarks, *notes_on_gaps(streams), *notes_on_units(streams, mapping))
    notes = [f"{source.path}: {line}" for line in remarks]
    parts = split_recording(source.path, streams, mapping, document)
    runs = [
        describe_run(source, "-".join(filter(None, (joint, suffix))), part, mapping, document, notes)
        for suffix, part in parts
    ]
    faults = [fault for run in runs for fault in faults_of(run.info, {n: s.specs for n, s in run.streams.items()})]
    if faults:
        raise InputError([document.fault((), fault) for fault in dict.fromkeys(faults)])
    return runs


def wanted_columns(mapping: Mapping) -> list[WantedColumn]:
    """Return every column and field to which a mapping refers."""
    columns: list[WantedColumn] = []
    fields = [*mapping.setup.values(), *mapping.parameters.values(), *(value for _, value in mapping.run)]
    for stream in mapping.streams.values():
        columns += [WantedColumn(stream.time.column, stream.records)] if stream.time.column is not None else []
        for channel in stream.channels.values():
            columns.append(WantedColumn(channel.column, stream.records))
            fields += [channel.scale, channel.offset]
    label_settings = mapping.steps_by_column
    columns += (
        [WantedColumn(label_settings.time.column)]
        if label_settings and label_settings.time and label_settings.time.column is not None
        else []
    )
    return columns + [WantedColumn(value.field) for value in fields if isinstance(value, FieldOf)]


def label_columns(mapping: Mapping) -> list[WantedColumn]:
    """Return the columns of which the text counts: labels that name the steps, and attributes of the run."""
    label_settings = mapping.steps_by_column
    columns = [WantedColumn(value.field) for _, value in mapping.run if isinstance(value, FieldOf)]
    if label_settings:
        records = None if label_settings.time else mapping.streams[label_settings.stream].records
        columns.append(WantedColumn(label_settings.column, records))
    return columns


def describe_run(
    source: LogSource,
    suffix: str,
    streams: dict[str, Stream],
    mapping: Mapping,
    document: yamlfile.Document,
    notes: list[str],
) -> ImportedRun:
    """Build one run: description, streams, steps, origin and notes."""
    attributes = {
        name: text_value(source, value, ("run", name), document)
        for name, value in mapping.run
        if name not in ("created", "simulated")
    }
    setup, parameters = (
        {
            name: value if isinstance(value, str) else number_value(source, value, (block, name), document)
            for name, value in getattr(mapping, block).items()
        }
        for block in ("setup", "parameters")
    )
    name = f"{source.path.stem}-{suffix}" if suffix else source.path.stem
    digest = digest_of(source.path)
    ascii_name = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._") or "run"
    info = RunInfo(
        run_id=f"{ascii_name}-{digest[:DIGEST_DIGITS]}",  # recordings of two days may have one name
        simulated=mapping.run.simulated,
        mechanical=mapping.mechanical,
        software=f"leactl {__version__}",
        created=created_text(source, mapping, document),
        setup=setup,
        parameters=parameters,
        instruments={name: instrument.facts for name, instrument in mapping.instruments.items()},
        protocol=attributes["protocol"],
        bench=attributes["bench"],
        actuator=attributes["actuator"],
        condition=attributes["condition"],
        operator=attributes["operator"],
    )
    steps = steps_of(streams, mapping, document, str(source.path))
    origin = f"{source.path.name} (SHA-256 {digest}) by {Path(document.name).name}"
    file_name = re.sub(r"[^\w.-]+", "-", name).strip("-._") or "run"
    return ImportedRun(info, streams, steps, origin, notes, file_name)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, or for a folder that of the digests of its files in the order of their names."""
    if path.is_dir():
        parts = [digest_of(file) for file in sorted(path.iterdir()) if file.is_file()]
        return hashlib.sha256("".join(parts).encode()).hexdigest()
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def text_value(source: LogSource, value: str | FieldOf, keys: tuple[str, ...], document: yamlfile.Document) -> str:
    """Return a text of the mapping, or the value of the source's field that the mapping names."""
    if isinstance(value, str):
        return value
    try:
        field_value = source.field(value.field)
    except MissingColumn as lacking:
        raise InputError(document.fault((*keys, "field"), str(lacking))) from None
    return field_value if isinstance(field_value, str) else as_label(value.scale * field_value + value.offset)


def created_text(source: LogSource, mapping: Mapping, document: yamlfile.Document) -> str:
    """Return the time of the recording, `2026-01-31T10:15:30Z`, of the mapping, else the source, else its file."""
    if mapping.run.created is None:
        moment = source.began or datetime.fromtimestamp(source.path.stat().st_mtime, UTC)
    else:
        text = text_value(source, mapping.run.created, ("run", "created"), document)
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise InputError(document.fault(("run", "created"), f"{text!r} is no ISO 8601 date")) from None
    return f"{(moment if moment.tzinfo else moment.replace(tzinfo=UTC)).astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"


def targets_of(runs: Sequence[ImportedRun], out: Path) -> list[Path]:
    """Return the path of the file of each run.

    Raises
    ------
    InputError : one of the files exists.
    """
    targets = [out / f"{run.name}.h5" for run in runs]
    for target in targets:
        refuse_existing(target)
    return targets


def write_runs(runs: Sequence[ImportedRun], out: Path) -> list[Path]:
    """Write all runs into a temporary folder, then rename each to its final path; on failure none remains."""
    targets = targets_of(runs, out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        temporary_folder = Path(tempfile.mkdtemp(prefix=".import-", dir=out))
    except OSError as error:
        raise InputError(f"{out}: {error.strerror or error}") from None
    published: list[Path] = []
    try:
        for run in runs:
            with RunWriter(temporary_folder, run.info, {name: s.specs for name, s in run.streams.items()}) as writer:
                for name, stream in run.streams.items():
                    writer.append(name, stream.time, np.stack(stream.values, axis=1))
                for step in run.steps:
                    writer.step(*step)
                if run.steps:
                    writer.event(0.0, "info", "import", f"{len(run.steps)} steps as the mapping tells them")
                writer.event(0.0, "info", "import", run.origin)
                for note in run.notes:
                    writer.event(0.0, "warning", "import", note)
                for name, stream in run.streams.items():
                    if stream.aligned:
                        writer.event(0.0, "info", "import", f"stream {name}: {stream.aligned}")
        for run, target in zip(runs, targets, strict=True):
            move_without_overwriting(temporary_folder / f"{run.info.run_id}.h5", target)
            published.append(target)
    except BaseException:
        for target in published:
            target.unlink()
        raise
    finally:
        shutil.rmtree(temporary_folder, ignore_errors=True)
    return targets
