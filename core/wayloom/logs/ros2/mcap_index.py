"""Message index of an MCAP file, read through its chunk index, so that no recording is ever in memory.

The file's summary is read by the `mcap` library; the chunks' records are parsed here (https://mcap.dev/spec): all of a chunk's
bytes are read only where they are compressed, otherwise each record's first bytes are enough.
"""

import os
import struct
import threading
import zlib
from collections import Counter, OrderedDict
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import lz4.frame
import mcap.exceptions
import numpy as np
import zstandard
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.summary import Summary
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import quoted
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.ros2.foxglove import Translator, translator
from wayloom.logs.ros2.mcap_scan import MAGIC, Place, scan_file
from wayloom.logs.ros2.ros_messages import stamp_of

RECOVER: Final = "the recording was cut or damaged: repair it with `mcap recover`, or copy it again"
MESSAGE: Final = 0x05
CHUNK_HEAD, RECORD_HEAD, MESSAGE_HEAD = 8 + 8 + 8 + 4, 9, 22
PEEK: Final = 64
KEPT_CHUNKS: Final = 4
LARGEST_CHUNK: Final = 2**29
LATEST_NS: Final = 2**63 - 1
"""Times of a log have a sign, log times of a recording have none."""


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
    translator  of messages that are none of ROS 2
    """

    t_ns: NDArray[np.int64]
    chunk: NDArray[np.int64]
    start: NDArray[np.int64]
    length: NDArray[np.int64]
    translator: Translator | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


class McapFile:
    """An MCAP file that is open for reading by index. Raises LogError where it is damaged.

    `cut` says, in words, what is missing where the file has no index and was read as far as it is whole; else it is empty.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.cut = path, ""
        self._decompressed: OrderedDict[int, bytes] = OrderedDict()
        self._keeping = threading.Lock()
        self._places: dict[int, Place] = {}
        summary = self._summary()
        self._handle = os.open(path, os.O_RDONLY)
        if summary is not None:
            schemas, channels = summary.schemas, summary.channels
            chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
            self._chunks = [
                (chunk.chunk_start_offset, chunk.uncompressed_size, set(chunk.message_index_offsets)) for chunk in chunks
            ]
            counts = summary.statistics.channel_message_counts if summary.statistics else dict.fromkeys(channels, 1)
        else:
            schemas, channels, counts = self._scan()
        self._topic_of, self._translators = dict[int, Topic](), dict[str, Translator]()
        for number, channel in channels.items():
            self._add_channel(number, channel, schemas.get(channel.schema_id), counts.get(number, 0))

    def _scan(self) -> tuple[dict[int, Schema], dict[int, Channel], dict[int, int]]:
        """Schemas, channels and their messages' counts of a file without index, as far as it is whole."""
        found = scan_file(self._handle, self._unpacked_if_whole)
        self._chunks = [(0, size, set()) for size in found.unpacked_sizes]
        self._places = dict(enumerate(found.places))
        counts = Counter(channel for k in range(len(self._chunks)) for channel, *_ in self._walk(k))
        if not counts:
            raise LogError("has neither an index nor a whole message", file=self.path, remedy=RECOVER, reason="recording.damaged")
        size = os.fstat(self._handle).st_size
        where = "at its end" if found.is_closed else f"after {found.whole_bytes} of {size} bytes"
        self.cut = f"an index, and what should follow {where}: the recording was not closed, or was cut"
        return found.schemas, found.channels, dict(counts)

    def _add_channel(self, number: int, channel: Channel, schema: Schema | None, count: int) -> None:
        """A channel as a topic; one of Foxglove's schemas as of the ROS 2 type that it is read as."""
        name, kind, encoding = channel.topic, _full_name("" if schema is None else schema.name), channel.message_encoding
        if schema is not None:
            try:
                translated = translator(schema.name, encoding, schema.data)
            except CdrError as problem:
                raise LogError(
                    f"a topic {problem}", file=self.path, record=quoted(name), remedy=RECOVER, reason="recording.damaged"
                ) from None
            if translated is not None:
                self._translators[name], kind, encoding = translated, translated.kind, "cdr"
        self._topic_of[number] = Topic(name, kind, encoding, count)

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
        for k, (_, _, indexed) in enumerate(self._chunks):
            if indexed and not wanted.keys() & indexed:
                continue
            for channel, log_time, start, length, head in self._walk(k):
                if channel in wanted:
                    t_ns = (
                        self._stamp(k, start, length, head, wanted[channel]) if headers else self._logged(log_time, wanted[channel])
                    )
                    rows[wanted[channel]].append((t_ns, k, start, length))
        out = {}
        for name, found in rows.items():
            table = np.array(sorted(found), np.int64).reshape(-1, 4)
            columns = [table[:, column].copy() for column in range(4)]
            out[name] = Messages(columns[0], columns[1], columns[2], columns[3], self._translators.get(name))
        return out

    def first(self, name: str) -> bytes:
        """The first message of a topic that holds any."""
        channels = {number for number, topic in self._topic_of.items() if topic.name == name}
        for k, (_, _, indexed) in enumerate(self._chunks):
            if not indexed or channels & indexed:
                for channel, _, start, length, _ in self._walk(k):
                    if channel in channels:
                        return self._message(k, start, length, self._translators.get(name))
        raise LogError(
            "no message where the index says", file=self.path, record=quoted(name), remedy=RECOVER, reason="recording.damaged"
        )

    def read(self, messages: Messages, index: int) -> bytes:
        """The bytes of a message, in CDR. Raises CdrError where it cannot be translated."""
        start, length = int(messages.start[index]), int(messages.length[index])
        return self._message(int(messages.chunk[index]), start, length, messages.translator)

    def _message(self, k: int, start: int, length: int, translator: Translator | None) -> bytes:
        data = self._bytes(k, start, length)
        return bytes(data) if translator is None else translator.to_ros(data)

    def check(self, but: AbstractSet[int] = frozenset()) -> None:
        """Read every chunk but these and compare its check sum. Raises LogError at the first that is damaged."""
        for k in range(len(self._chunks)):
            if k in but:
                continue
            begin, size, compression, crc = self._place(k)
            if not compression and crc and zlib.crc32(self._pread(begin, size)) != crc:
                raise self._damaged("wrong check sum", k)
            if compression:
                self._records(k)

    def _summary(self) -> Summary | None:
        """The file's summary, None where it has none or a damaged one."""
        try:
            with self.path.open("rb") as stream:
                if stream.read(len(MAGIC)) != MAGIC:
                    raise LogError("is no MCAP file", file=self.path, remedy="give a ROS 2 recording in MCAP")
                stream.seek(0)
                summary = SeekingReader(stream).get_summary()
        except OSError as problem:
            raise LogError(f"cannot be read ({problem.strerror})", file=self.path, remedy="check its permissions") from None
        except (mcap.exceptions.McapError, ValueError, struct.error, MemoryError, UnicodeDecodeError):
            return None
        except (zstandard.ZstdError, RuntimeError):  # of zstd and lz4: what is said to be the summary has a damaged chunk in it
            return None
        return summary if summary is not None and summary.chunk_indexes else None

    def _logged(self, log_time: int, topic: str) -> int:
        """A log time, of 64 bits without sign, as the times of a log are, with one."""
        if log_time > LATEST_NS:
            raise LogError(
                f"a message at {log_time} ns", file=self.path, record=quoted(topic), remedy=RECOVER, reason="recording.damaged"
            )
        return log_time

    def _stamp(self, k: int, start: int, length: int, head: bytes, topic: str) -> int:
        try:
            translator = self._translators.get(topic)
            return stamp_of(head) if translator is None else translator.stamp(self._bytes(k, start, length))
        except CdrError as problem:
            raise LogError(
                f"a message {problem}", file=self.path, record=quoted(topic), remedy=RECOVER, reason="recording.damaged"
            ) from None

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
        """A compressed chunk's records; the last few stay in memory. Several threads may ask."""
        records = self._decompressed.get(k)
        if records is None:
            records = self._unpacked(self._place(k), self._chunks[k][1], k)
            with self._keeping:
                self._decompressed[k] = records
                while len(self._decompressed) > KEPT_CHUNKS:
                    self._decompressed.popitem(last=False)
        return records

    def _unpacked(self, place: Place, limit: int, k: int) -> bytes:
        begin, size, compression, crc = place
        packed = self._pread(begin, size)
        try:
            if limit > LARGEST_CHUNK:
                raise ValueError(f"{limit} bytes")
            unpacked = unpacked_zstd(packed, limit) if compression == "zstd" else unpacked_lz4(packed, limit)
        except (zstandard.ZstdError, RuntimeError, ValueError, MemoryError, EOFError) as problem:
            raise self._damaged(f"cannot be unpacked ({' '.join(str(problem).split())[:60]})", k) from None
        if crc and zlib.crc32(unpacked) != crc:
            raise self._damaged("wrong check sum", k)
        return unpacked

    def _unpacked_if_whole(self, place: Place, limit: int) -> bytes | None:
        try:
            return self._unpacked(place, limit, -1)
        except LogError:
            return None

    def _place(self, k: int) -> Place:
        """Offset and length of a chunk's records in the file, their compression, and their check sum."""
        if k not in self._places:
            offset = self._chunks[k][0]
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
        except (OverflowError, MemoryError):
            what = "has an index that leads beyond all files"
            raise LogError(what, file=self.path, remedy=RECOVER, reason="recording.damaged") from None
        if len(data) < length:
            raise LogError(f"ends after {offset + len(data)} bytes", file=self.path, remedy=RECOVER, reason="recording.damaged")
        return data

    def _damaged(self, what: str, k: int) -> LogError:
        return LogError(what, file=self.path, record=f"chunk {k}", remedy=RECOVER, reason="recording.damaged")


def unpacked_zstd(packed: bytes, limit: int) -> bytes:
    """At most `limit` bytes, whatever the frame's own header promises. Raises ZstdError, ValueError."""
    with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
        return _within(stream.read(limit + 1), limit)


def unpacked_lz4(packed: bytes, limit: int) -> bytes:
    """At most `limit` bytes. Raises RuntimeError, EOFError, ValueError."""
    stream = lz4.frame.LZ4FrameDecompressor()
    unpacked = stream.decompress(packed, max_length=limit + 1)
    if not stream.eof and len(unpacked) <= limit:
        raise EOFError("the frame is not whole")
    return _within(unpacked, limit)


def _within(unpacked: bytes, limit: int) -> bytes:
    if len(unpacked) != limit:
        raise ValueError(f"other than the {limit} bytes that it should hold")
    return unpacked


def _full_name(kind: str) -> str:
    """sensor_msgs/Image of ROS 1 style is sensor_msgs/msg/Image."""
    parts = kind.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else kind
