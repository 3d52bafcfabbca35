"""Read MCAP logs: messages in JSON, and messages of ROS 2 by the definitions in the file.

The container is read by the package `mcap`, chunk by chunk, and no chunk is decompressed beyond its announced size;
definitions and CDR are read by `rosbags` (MCAP specification, mcap.dev/spec; its registry of well-known encodings).
"""

import json
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final

from leactl.errors import InputError
from leactl.regular_files import open_regular
from leactl.runfile.importing.sources.messages import Message, MessageSource, OpenLog, Topic
from leactl.runfile.importing.sources.ros_types import RosTypes, packages
from leactl.runfile.importing.sources.source import SourceRequest, reason_text

ENDINGS = (".mcap",)
LARGEST_CHUNK: Final = 1 << 28  # bytes after decompression; recorders write chunks of some megabytes
LARGEST_RECORD: Final = 1 << 28  # bytes of a record of the log
MAGIC: Final = b"\x89MCAP0\r\n"
SHORTEST_FILE: Final = 2 * len(MAGIC) + 29  # bytes: both magics and a footer
TRUNCATED = "truncated: it ends before its footer; `mcap recover` saves what is whole"


def open_source(path: Path, request: SourceRequest) -> MessageSource:
    """Open an MCAP log.

    Raises
    ------
    InputError : the file is not MCAP, truncated or damaged, or the packages that read it are missing.
    """
    with packages(path), open_regular(path) as file:
        opened = McapFile(path, file)
        return MessageSource(OpenLog(path, opened.topics, opened.messages), request)


class McapFile:
    """An open MCAP file; each call of `messages` reads it from the beginning."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self._types = RosTypes()
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self.topics: dict[str, Topic] = {}
        self._learn_topics()

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of these topics, in the order of the file."""
        for record in self._records(set(topics)):
            channel = self._channels[record.channel_id]
            decode = partial(self._decoder(channel), record.data)
            yield Message(channel.topic, record.log_time, record.publish_time, decode)

    def _learn_topics(self) -> None:
        """Read schemas and channels from the file's summary, or from the whole file if it has none."""
        from mcap.reader import SeekingReader

        self._file.seek(0)
        first_bytes = self._file.read(len(MAGIC))
        if first_bytes != MAGIC:
            raise InputError(f"{self._path}: {TRUNCATED if MAGIC.startswith(first_bytes) else 'not an MCAP file'}")
        if self._file.seek(0, os.SEEK_END) >= SHORTEST_FILE:
            self._file.seek(-len(MAGIC), os.SEEK_END)
        if self._file.read() != MAGIC:
            raise InputError(f"{self._path}: {TRUNCATED}")
        self._file.seek(0)
        with self._readable():
            summary = SeekingReader(self._file, record_size_limit=LARGEST_RECORD).get_summary()
            if summary and summary.channels:
                self._schemas |= summary.schemas
                for channel in summary.channels.values():
                    self._announce(channel)
        if not self.topics:
            for _ in self._records(set()):
                pass

    def _records(self, topics: set[str]) -> Iterator[Any]:
        """Yield the message records of these topics; schemas and channels on the way are stored."""
        from mcap.records import Channel, Chunk, Schema
        from mcap.records import Message as Record
        from mcap.stream_reader import StreamReader, breakup_chunk

        self._file.seek(0)
        with self._readable():
            for record in StreamReader(self._file, emit_chunks=True, record_size_limit=LARGEST_RECORD).records:
                for part in breakup_chunk(self._unpacked(record)) if isinstance(record, Chunk) else [record]:
                    if isinstance(part, Schema):
                        self._schemas[part.id] = part
                    elif isinstance(part, Channel):
                        self._announce(part)
                    elif isinstance(part, Record):
                        if part.channel_id not in self._channels:
                            raise InputError(f"{self._path}: damaged: a message of channel {part.channel_id}, unknown")
                        if self._channels[part.channel_id].topic in topics:
                            yield part

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Convert the reader's errors on a damaged file to an InputError of one line."""
        from mcap.exceptions import EndOfFile, InvalidMagic, McapError

        try:
            yield
        except (EndOfFile, InvalidMagic):  # the first bytes are those of MCAP, so that the end is missing
            raise InputError(f"{self._path}: {TRUNCATED}") from None
        except McapError as error:
            raise InputError(f"{self._path}: damaged: {reason_text(error)}") from None
        # the reader raises any of these for damaged lengths
        except (ValueError, LookupError, MemoryError, OverflowError, EOFError, OSError, struct.error) as error:
            raise InputError(f"{self._path}: damaged: {reason_text(error)}") from None

    def _unpacked(self, chunk: Any) -> Any:
        """Decompress a chunk, and check its size and CRC.

        Raises
        ------
        InputError : it decompresses to another size than announced, or announces more than `LARGEST_CHUNK`.
        """
        import lz4.frame
        import zstandard
        from mcap.records import Chunk

        size = chunk.uncompressed_size
        if size > LARGEST_CHUNK:
            raise InputError(f"{self._path}: a chunk says that it unpacks to {size} bytes; at most {LARGEST_CHUNK} are")
        try:
            if chunk.compression == "zstd":
                with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                    data = reader.read(size + 1)
            elif chunk.compression == "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            elif chunk.compression == "":
                data = chunk.data
            else:
                raise InputError(f"{self._path}: a chunk is packed by {chunk.compression!r}; lz4 or zstd was expected")
        except (zstandard.ZstdError, RuntimeError, EOFError) as error:
            raise InputError(f"{self._path}: damaged: a chunk does not unpack: {error}") from None
        if len(data) != size:
            size_text = f"{'more than ' * (len(data) > size)}{min(len(data), size)}"
            raise InputError(f"{self._path}: damaged: a chunk unpacks to {size_text} bytes where it says {size}")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):  # 0 where the recorder made none
            raise InputError(f"{self._path}: damaged: a chunk is not what its CRC says")
        content = {"compression": "", "data": data, "uncompressed_size": size, "uncompressed_crc": 0}
        times = {"message_start_time": chunk.message_start_time, "message_end_time": chunk.message_end_time}
        return Chunk(**content, **times)

    def _announce(self, channel: Any) -> None:
        """Add the topic of a channel once, with the reason if its messages cannot be decoded."""
        if channel.id in self._channels:
            return
        self._channels[channel.id] = channel
        schema = self._schemas.get(channel.schema_id)
        kind = schema.name if schema else ""
        reason = ""
        if channel.message_encoding == "cdr" and schema is not None:
            reason = self._types.learn(kind, schema.encoding, schema.data)
        elif channel.message_encoding != "json":
            reason = f"is in {channel.message_encoding or 'no encoding'}; json or cdr with its definition was expected"
        self.topics[channel.topic] = Topic(channel.topic, kind, reason)

    def _decoder(self, channel: Any) -> Callable[[bytes], Any]:
        """Return the function that decodes the messages of a channel."""
        if channel.message_encoding == "json":
            return json.loads
        kind = self._schemas[channel.schema_id].name
        return lambda data: self._types.decode(kind, data)
