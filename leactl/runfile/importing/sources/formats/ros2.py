"""Read ROS 2 bags by `rosbags`: a folder with `metadata.yaml` and files of SQLite or MCAP, or a single `.db3`.

Types come from the definitions in the bag (since ROS 2 Iron), else from those that ROS 2 ships.
"""

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, Final

from leactl import yamlfile
from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.importing.sources.formats.mcap import LARGEST_RECORD, McapFile
from leactl.runfile.importing.sources.messages import Message, MessageSource, OpenLog, Topic
from leactl.runfile.importing.sources.ros_types import RosTypes, packages
from leactl.runfile.importing.sources.source import SourceRequest, reason_text

ENDINGS = (".db3",)
METADATA: Final = "metadata.yaml"
NEWEST_METADATA: Final = 9  # version of the metadata
SQLITE: Final = b"SQLite format 3\0"
MOST_FILES: Final = 1000  # of a bag
IN_ORDER: Final = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) ORDER BY id"


def recognises(path: Path, head: bytes) -> bool:
    """Return whether a path is the folder of a bag."""
    return path.is_dir() and (path / METADATA).is_file()


def open_source(path: Path, request: SourceRequest) -> MessageSource:
    """Open a bag.

    Raises
    ------
    InputError : the path is not a bag, its files are compressed or damaged, or the packages that read it are missing.
    """
    with packages(path), ExitStack() as stack:
        files, unpack = files_of(path) if path.is_dir() else ([path], False)
        opened = [open_file(file, unpack, stack) for file in files]
        topics: dict[str, Topic] = {}
        for bag_file in opened:
            for name, topic in bag_file.topics.items():
                first_topic = topics.setdefault(name, topic)
                if first_topic.kind != topic.kind:
                    topics[name] = topic._replace(
                        unreadable=f"is of {first_topic.kind} in one file and {topic.kind} in another"
                    )

        def messages(wanted: Collection[str]) -> Iterator[Message]:
            for bag_file in opened:
                yield from bag_file.messages(wanted)

        return MessageSource(OpenLog(path, topics, messages), request)


def files_of(folder: Path) -> tuple[list[Path], bool]:
    """Return the files of a bag in their order, and whether each message is compressed.

    Raises
    ------
    InputError : the metadata list no files or are too new, or files are compressed or missing.
    """
    document = yamlfile.load(folder / METADATA)
    information = document.data.get("rosbag2_bagfile_information") if isinstance(document.data, dict) else None
    names = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(information, dict) or not isinstance(names, list) or not 0 < len(names) <= MOST_FILES:
        raise InputError(f"{folder / METADATA}: rosbag2_bagfile_information.relative_file_paths: files were expected")
    if not isinstance(version := information.get("version"), int) or version > NEWEST_METADATA:
        raise InputError(f"{folder / METADATA}: version {version}; at most {NEWEST_METADATA} is read")
    mode = str(information.get("compression_mode") or "none").lower()
    if mode not in ("none", "message", "storage"):
        hint = "its files are packed; unpack them by `zstd -d` and set compression_mode to none"
        raise InputError(f"{folder / METADATA}: compression_mode {mode!r}: {hint}")
    files = [folder / PurePosixPath(str(name)).name for name in names]
    if missing_names := [file.name for file in files if not file.is_file()]:
        raise InputError(f"{folder}: {', '.join(missing_names)}: no such file, which {METADATA} names")
    return files, mode == "message"


def open_file(path: Path, unpack: bool, stack: ExitStack) -> "McapFile | BagFile":
    """Open one file of a bag until the stack is closed.

    Raises
    ------
    InputError : the file is neither SQLite nor MCAP, or a write-ahead log beside it still has the last messages.
    """
    file = stack.enter_context(open_regular(path))
    if path.suffix == ".mcap":
        return McapFile(path, file)
    if file.read(len(SQLITE)) != SQLITE:
        raise InputError(f"{path}: neither SQLite nor MCAP, of which bags are")
    write_ahead_log = path.with_name(f"{path.name}-wal")
    if write_ahead_log.is_file() and write_ahead_log.stat().st_size:
        raise InputError(
            f"{path}: was never closed, {write_ahead_log.name} holds its last messages; `ros2 bag reindex` joins them"
        )
    return BagFile(path, unpack, stack)


class BagFile:
    """An open bag file of SQLite."""

    def __init__(self, path: Path, unpack: bool, stack: ExitStack) -> None:
        from rosbags.rosbag2 import Reader

        self._path, self._unpack = path, unpack
        self._types = RosTypes()
        with self._readable():
            self._reader: Any = stack.enter_context(Reader(path))
            self.topics = {connection.topic: self._announced(connection) for connection in self._reader.connections}

    def messages(self, wanted: Collection[str]) -> Iterator[Message]:
        """Yield the messages of these topics, in the order of writing.

        The library's reader sorts them by the recorder's stamps, which hides that its clock was set back.
        """
        connections = {
            connection.id: connection for connection in self._reader.connections if connection.topic in wanted
        }
        uri = f"{self._path.absolute().as_uri()}?immutable=1"
        with self._readable(), closing(sqlite3.connect(uri, uri=True)) as bag:
            placeholders = ", ".join("?" * len(connections))
            for topic_id, stamp_ns, data in bag.execute(IN_ORDER.format(placeholders), tuple(connections)):
                connection = connections[topic_id]
                decode = partial(self._decode, connection.msgtype, bytes(data))
                yield Message(connection.topic, stamp_ns, stamp_ns, decode)

    def _decode(self, kind: str, data: bytes) -> Any:
        """Decompress a message if needed, and decode it."""
        if self._unpack:
            import zstandard

            with zstandard.ZstdDecompressor().stream_reader(data) as reader:
                data = reader.read(LARGEST_RECORD)
        return self._types.decode(kind, data)

    def _announced(self, connection: Any) -> Topic:
        """Return the topic of a connection, with the reason if its messages cannot be decoded."""
        from rosbags.interfaces import MessageDefinitionFormat

        kind, definition = connection.msgtype, connection.msgdef
        encodings = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
        if connection.ext.serialization_format != "cdr":
            return Topic(connection.topic, kind, f"is in {connection.ext.serialization_format}; cdr was expected")
        if definition.format in encodings:
            reason = self._types.learn(kind, encodings[definition.format], definition.data.encode())
        else:
            reason = self._types.usual(kind)
        return Topic(connection.topic, kind, reason)

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Convert the reader's errors on a damaged file to an InputError of one line."""
        import apsw
        from rosbags.rosbag2 import ReaderError

        try:
            yield
        except InputError:
            raise
        except (ReaderError, apsw.Error, sqlite3.Error, ValueError, LookupError, TypeError, OSError) as error:
            raise InputError(f"{self._path}: damaged, or no bag: {reason_text(error)}") from None
