"""Decode messages of ROS 2 by the definitions in their logs, with the package `rosbags`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from leactl.errors import InputError
from leactl.runfile.importing.sources.source import reason_text

MOST_PARTS: Final = 10_000  # fields of a message, nested ones included; rosbags generates code for each
UNFINISHED_COUNT: Final = 0  # mark of a type whose fields are being counted
SEPARATOR: Final = "=" * 80 + "\n"  # between the definitions of a schema of kind ros2idl


@contextmanager
def packages(path: Path) -> Iterator[None]:
    """Convert an ImportError in the block to a message that names the extra to install.

    Raises
    ------
    InputError : a package is missing.
    """
    try:
        yield
    except ImportError as fault:
        message = f"{path}: needs mcap and rosbags: pip install 'leactl[ros]' ({fault})"
        raise InputError(message) from fault


class RosTypes:
    """Store of message types, each registered once."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store: Any = get_typestore(Stores.EMPTY)
        self._shipped_store: Any = None
        self._failures: dict[tuple[str, bytes], str] = {}

    def learn(self, kind: str, encoding: str, text: bytes) -> str:
        """Register a type, and the types that it uses, from their definition; return why that failed, else ""."""
        if (kind, text) not in self._failures:
            self._failures[kind, text] = self._registration_failure(kind, encoding, text)
        return self._failures[kind, text]

    def usual(self, kind: str) -> str:
        """Use the definition of a type that ROS 2 ships; return a reason if there is none, else ""."""
        from rosbags.typesys import Stores, get_typestore

        self._shipped_store = self._shipped_store or get_typestore(Stores.LATEST)
        if kind not in self._shipped_store.fielddefs:
            return f"is of {kind}, of which neither the log nor ROS 2 itself has a definition"
        return ""

    def decode(self, kind: str, data: bytes) -> Any:
        """Decode a message to an object with fields.

        Raises
        ------
        Exception : of any kind, if the bytes are not of that type.
        """
        store = self._store if kind in self._store.fielddefs else self._shipped_store
        return store.deserialize_cdr(data, kind)

    def _registration_failure(self, kind: str, encoding: str, text: bytes) -> str:
        """Register a type and the types that it uses; return why that failed, else ""."""
        from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

        if encoding not in ("ros2msg", "ros2idl"):
            return f"is defined in {encoding or 'nothing'}; ros2msg or ros2idl was expected"
        try:
            definition = text.decode()
            types: dict[str, Any] = {}
            if encoding == "ros2msg":
                types = dict(get_types_from_msg(definition, kind))
            else:
                for file_text in definition.split(SEPARATOR):
                    # included files are separate parts of the text, and rosbags does not know directives
                    idl_text = "\n".join(line for line in file_text.splitlines() if not line.startswith(("IDL: ", "#")))
                    types |= get_types_from_idl(idl_text) if idl_text.strip() else {}
            known_types = self._store.fielddefs
            if parts_of(kind, {**known_types, **types}, {}) > MOST_PARTS:
                return f"has a definition of more than {MOST_PARTS} parts; fewer were expected"
            self._store.register({name: fields for name, fields in types.items() if name not in known_types})
        except (TypesysError, UnicodeDecodeError, RecursionError, KeyError, ValueError) as error:
            return f"has a definition that cannot be read: {reason_text(error)}"
        return ""


def parts_of(kind: str, types: dict[str, Any], counted: dict[str, int]) -> int:
    """Return the number of fields of a message type, including nested ones.

    An array of messages or texts counts by its length.

    Raises
    ------
    TypesysError : a nested type is not defined, or a type contains itself.
    """
    from rosbags.typesys import TypesysError

    if kind not in types:
        raise TypesysError(f"{kind} is used and not defined")
    if counted.get(kind) == UNFINISHED_COUNT:
        raise TypesysError(f"{kind} holds itself")
    if kind not in counted:
        counted[kind] = UNFINISHED_COUNT
        parts = 1 + sum(parts_of_field(field, types, counted) for _, field in types[kind][1])
        counted[kind] = min(parts, MOST_PARTS + 1)
    return counted[kind]


def parts_of_field(field: Any, types: dict[str, Any], counted: dict[str, int]) -> int:
    """Return the number of fields that a field expands to."""
    from rosbags.interfaces import Nodetype

    node, details = field
    if node == Nodetype.NAME:
        return parts_of(details, types, counted)
    if node == Nodetype.BASE:
        return 1
    inner, length = details
    is_plain = inner[0] == Nodetype.BASE and inner[1][0] != "string"
    return 1 if is_plain else parts_of_field(inner, types, counted) * (length if node == Nodetype.ARRAY else 1)
