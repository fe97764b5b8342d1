"""Message index of an MCAP file, read through its chunk index, so that no recording is ever in memory.

The file's summary is read by the `mcap` library; the chunks' records are parsed here (https://mcap.dev/spec): all of a chunk's
bytes are read only where they are compressed, otherwise each record's first bytes are enough.
"""

import os
import struct
import zlib
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import lz4.frame
import mcap.exceptions
import numpy as np
import zstandard
from mcap.reader import SeekingReader
from mcap.records import ChunkIndex
from mcap.summary import Summary
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import quoted
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.ros2.ros_messages import stamp_of

MAGIC: Final = b"\x89MCAP0\r\n"
RECOVER: Final = "the recording was cut or damaged: repair it with `mcap recover`, or copy it again"
MESSAGE: Final = 0x05
CHUNK_HEAD, RECORD_HEAD, MESSAGE_HEAD = 8 + 8 + 8 + 4, 9, 22
PEEK: Final = 64
KEPT_CHUNKS: Final = 4
LARGEST_CHUNK: Final = 2**31


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic: its messages' type such as sensor_msgs/msg/Image, their encoding, and how many there are."""

    name: str
    kind: str
    encoding: str
    count: int


@dataclass(frozen=True, slots=True)
class Messages:
    """The messages of one topic in the order of their own time stamps.

    t_ns    (N,) int64, from the messages' headers; from the log where messages have no header
    chunk   (N,) which chunk; start, length (N,) where in its records
    """

    t_ns: NDArray[np.int64]
    chunk: NDArray[np.int64]
    start: NDArray[np.int64]
    length: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.t_ns)


class McapFile:
    """An MCAP file that is open for reading by index. Raises LogError where it is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        summary = self._summary()
        self._chunks: list[ChunkIndex] = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        counts = summary.statistics.channel_message_counts if summary.statistics else dict.fromkeys(summary.channels, 1)
        self._topic_of = {
            number: Topic(
                channel.topic,
                _full_name(summary.schemas[channel.schema_id].name if channel.schema_id in summary.schemas else ""),
                channel.message_encoding,
                counts.get(number, 0),
            )
            for number, channel in summary.channels.items()
        }
        self._handle = os.open(path, os.O_RDONLY)
        self._decompressed: OrderedDict[int, bytes] = OrderedDict()
        self._places: dict[int, tuple[int, int, str, int]] = {}

    def __del__(self) -> None:
        if (handle := getattr(self, "_handle", None)) is not None:
            os.close(handle)

    @property
    def topics(self) -> list[Topic]:
        """All topics that hold messages, by name."""
        return sorted((topic for topic in self._topic_of.values() if topic.count), key=lambda topic: topic.name)

    def messages(self, names: set[str], headers: bool = True) -> dict[str, Messages]:
        """Index of the messages of these topics, from one pass over the chunks that hold any."""
        wanted = {number: topic.name for number, topic in self._topic_of.items() if topic.name in names}
        rows: dict[str, list[tuple[int, int, int, int]]] = {name: [] for name in names}
        for k, chunk in enumerate(self._chunks):
            if chunk.message_index_offsets and not wanted.keys() & chunk.message_index_offsets.keys():
                continue
            for channel, log_time, start, length, head in self._walk(k):
                if channel in wanted:
                    t_ns = self._stamp(head, wanted[channel]) if headers else log_time
                    rows[wanted[channel]].append((t_ns, k, start, length))
        out = {}
        for name, found in rows.items():
            table = np.array(sorted(found), np.int64).reshape(-1, 4)
            out[name] = Messages(*(table[:, column].copy() for column in range(4)))
        return out

    def first(self, name: str) -> bytes:
        """The first message of a topic that holds any."""
        channels = {number for number, topic in self._topic_of.items() if topic.name == name}
        for k, chunk in enumerate(self._chunks):
            if not chunk.message_index_offsets or channels & chunk.message_index_offsets.keys():
                for channel, _, start, length, _ in self._walk(k):
                    if channel in channels:
                        return bytes(self._bytes(k, start, length))
        raise LogError("no message where the index says", file=self.path, record=quoted(name), remedy=RECOVER)

    def read(self, messages: Messages, index: int) -> bytes:
        """The bytes of a message."""
        start, length = int(messages.start[index]), int(messages.length[index])
        return bytes(self._bytes(int(messages.chunk[index]), start, length))

    def check(self) -> None:
        """Read every chunk and compare its check sum. Raises LogError at the first that is damaged."""
        for k in range(len(self._chunks)):
            begin, size, compression, crc = self._place(k)
            if not compression and crc and zlib.crc32(self._pread(begin, size)) != crc:
                raise self._damaged("wrong check sum", k)
            if compression:
                self._records(k)

    def _summary(self) -> Summary:
        try:
            with self.path.open("rb") as stream:
                if stream.read(len(MAGIC)) != MAGIC:
                    raise LogError("is no MCAP file", file=self.path, remedy="give a ROS 2 recording in MCAP")
                stream.seek(0)
                summary = SeekingReader(stream).get_summary()
        except OSError as problem:
            raise LogError(f"cannot be read ({problem.strerror})", file=self.path, remedy="check its permissions") from None
        except (mcap.exceptions.McapError, ValueError, struct.error, MemoryError, UnicodeDecodeError) as problem:
            what = f"its end is no MCAP summary ({type(problem).__name__})"
            raise LogError(what, file=self.path, remedy=RECOVER) from None
        if summary is None or not summary.chunk_indexes:
            raise LogError("has no index of its messages", file=self.path, remedy=RECOVER)
        return summary

    def _stamp(self, head: bytes, topic: str) -> int:
        try:
            return stamp_of(head)
        except CdrError as problem:
            raise LogError(f"a message {problem}", file=self.path, record=quoted(topic), remedy=RECOVER) from None

    def _walk(self, k: int) -> Iterator[tuple[int, int, int, int, bytes]]:
        """Channel, log time, start, length and first bytes of each message of a chunk."""
        _, size, compression, _ = self._place(k)
        total = len(self._records(k)) if compression else size
        at = 0
        while at < total:
            head = self._bytes(k, at, min(PEEK, total - at))
            if len(head) < RECORD_HEAD:
                raise self._damaged("ends in the middle of a record", k)
            opcode, length = struct.unpack_from("<BQ", head)
            start, at = at + RECORD_HEAD, at + RECORD_HEAD + length
            if at > total:
                raise self._damaged("ends in the middle of a record", k)
            if opcode == MESSAGE:
                if length < MESSAGE_HEAD:
                    raise self._damaged("a message without its head", k)
                channel, _, log_time = struct.unpack_from("<HIQ", head, RECORD_HEAD)
                yield channel, log_time, start + MESSAGE_HEAD, length - MESSAGE_HEAD, bytes(head[RECORD_HEAD + MESSAGE_HEAD :])

    def _bytes(self, k: int, start: int, length: int) -> bytes | memoryview:
        begin, _, compression, _ = self._place(k)
        if not compression:
            return self._pread(begin + start, length)
        return memoryview(self._records(k))[start : start + length]

    def _records(self, k: int) -> bytes:
        """A compressed chunk's records; the last few stay in memory."""
        if k not in self._decompressed:
            begin, size, compression, crc = self._place(k)
            packed = self._pread(begin, size)
            limit = int(self._chunks[k].uncompressed_size)
            try:
                if limit > LARGEST_CHUNK:
                    raise ValueError(f"{limit} bytes")
                unpacked = (
                    zstandard.ZstdDecompressor().decompress(packed, max_output_size=limit)
                    if compression == "zstd"
                    else lz4.frame.decompress(packed)
                )
            except (zstandard.ZstdError, RuntimeError, ValueError, MemoryError) as problem:
                raise self._damaged(f"cannot be unpacked ({' '.join(str(problem).split())[:60]})", k) from None
            if crc and zlib.crc32(unpacked) != crc:
                raise self._damaged("wrong check sum", k)
            self._decompressed[k] = unpacked
            while len(self._decompressed) > KEPT_CHUNKS:
                self._decompressed.popitem(last=False)
        return self._decompressed[k]

    def _place(self, k: int) -> tuple[int, int, str, int]:
        """Offset and length of a chunk's records in the file, their compression, and their check sum."""
        if k not in self._places:
            offset = self._chunks[k].chunk_start_offset
            head = self._pread(offset, RECORD_HEAD + CHUNK_HEAD + 4)
            crc, name_length = struct.unpack("<BQQQQII", head)[5:]
            if name_length > 16:
                raise self._damaged("no chunk where the index says", k)
            tail = self._pread(offset + len(head), name_length + 8)
            compression = tail[:name_length].decode("ascii", "replace")
            if compression not in ("", "zstd", "lz4"):
                raise self._damaged(f"compressed by {quoted(compression)}, which is not known", k)
            (size,) = struct.unpack_from("<Q", tail, name_length)
            begin = offset + len(head) + len(tail)
            if begin + size > os.fstat(self._handle).st_size:
                raise self._damaged("ends after the file does", k)
            self._places[k] = (begin, size, compression, crc)
        return self._places[k]

    def _pread(self, offset: int, length: int) -> bytes:
        try:
            data = os.pread(self._handle, length, offset)
        except OSError as problem:
            raise LogError(f"cannot be read ({problem.strerror})", file=self.path, remedy="check the disk") from None
        if len(data) < length:
            raise LogError(f"ends after {offset + len(data)} bytes", file=self.path, remedy=RECOVER)
        return data

    def _damaged(self, what: str, k: int) -> LogError:
        return LogError(what, file=self.path, record=f"chunk {k}", remedy=RECOVER)


def _full_name(kind: str) -> str:
    """sensor_msgs/Image of ROS 1 style is sensor_msgs/msg/Image."""
    parts = kind.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else kind
