"""Import one log of several joints as several runs: `{joint}` in a mapping's paths is replaced by each joint's name."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

from leactl.errors import InputError
from leactl.runfile.importing.mapping import PLACEHOLDER, Mapping
from leactl.runfile.importing.sources.source import ListedTable
from leactl.yamlfile import Document

ALL: Final[Literal["all"]] = "all"


def asks_for_joints(document: Document) -> bool:
    """Return whether any text of a mapping contains `{joint}`."""
    return any(PLACEHOLDER in text for text in _texts(document.data))


def for_joint(document: Document, joint: str) -> tuple[Mapping, Document]:
    """Return mapping and document with `{joint}` replaced by a joint's name; faults keep the file's lines."""
    joint_document = replace(document, data=_filled(document.data, joint))
    return joint_document.validate(Mapping), joint_document


def joints_of(path: Path, mapping: Mapping, tables: Sequence[ListedTable], document: Document) -> list[str]:
    """Return the names of a source's joints, in the records that the mapping addresses by `{joint}`.

    Raises
    ------
    InputError : the source lists no joints there.
    """
    joint_records = {stream.records for stream in mapping.streams.values() if PLACEHOLDER in (stream.records or "")}
    joints = [
        joint for table in tables if not joint_records or table.records in joint_records for joint in table.joints
    ]
    if not joints:
        records_text = ", ".join(sorted(map(str, joint_records))) or "its columns"
        raise InputError(document.fault(("joints",), f"{path}: lists no joints in {records_text}; give their names"))
    return list(dict.fromkeys(joints))


def _texts(data: Any) -> Iterator[str]:
    """Yield every text of a document."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict):
        for value in data.values():
            yield from _texts(value)
    elif isinstance(data, list):
        for value in data:
            yield from _texts(value)


def _filled(data: Any, joint: str) -> Any:
    """Return the same data with a joint's name in place of `{joint}`."""
    if isinstance(data, str):
        return data.replace(PLACEHOLDER, joint)
    if isinstance(data, dict):
        return {key: _filled(value, joint) for key, value in data.items()}
    return [_filled(value, joint) for value in data] if isinstance(data, list) else data
