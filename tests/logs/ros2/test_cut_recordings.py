"""Recordings that were never closed, or were cut: read as far as they go, and told."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from logs.made_drives import FRAMES, made_frames, write_drive
from wayloom.errors import InputError
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import open_log
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.mcap_index import McapFile


def rewritten(source: Path, file: Path, compression: CompressionType, chunked: bool = True) -> Path:
    """The product's own recording with small chunks, or with none."""
    found = McapFile(source)
    names = {topic.name: topic for topic in found.topics}
    index = found.messages(set(names), headers=False)
    messages = [(int(t_ns), name, row) for name, of in index.items() for row, t_ns in enumerate(of.t_ns)]
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=12_000, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2", library="test")
        schemas = {
            name: writer.register_schema(topic.kind, "ros2msg", ros.schema(topic.kind).encode()) for name, topic in names.items()
        }
        channels = {name: writer.register_channel(name, "cdr", schema) for name, schema in schemas.items()}
        for number, (t_ns, name, row) in enumerate(sorted(messages)):
            writer.add_message(channels[name], t_ns, found.read(index[name], row), t_ns, number)
        writer.finish()
    return file


CHUNK, CHUNK_INDEX = 0x06, 0x08


def records_of(data: bytearray, kind: int) -> Iterator[int]:
    """Where the records of a kind begin: one byte tells it, eight the length."""
    at = 8
    while at < len(data) - 8:
        if data[at] == kind:
            yield at
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return next(write_drive(tmp_path_factory.mktemp("whole"), "mcap").glob("*.mcap"))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_a_cut_recording_gives_the_frames_that_it_still_holds_and_says_where_it_ends(
    tmp_path: Path, recording: Path, compression: CompressionType
) -> None:
    data = rewritten(recording, tmp_path / "small.mcap", compression).read_bytes()
    expected, counts = made_frames(FRAMES, True), []
    for share in (0.45, 0.6, 0.75, 0.9):
        file = tmp_path / f"cut-{share}.mcap"
        file.write_bytes(data[: int(share * len(data))])
        log = open_log(file)
        assert log.missing[0].startswith("an index, and what should follow")
        assert f"of {file.stat().st_size} bytes" in log.missing[0] or "at its end" in log.missing[0]
        for got, frame in zip(log.frames(), expected, strict=False):
            assert got.t_ns == frame.t_ns
            np.testing.assert_array_equal(got.left, frame.left)
            np.testing.assert_array_equal(got.right, frame.right)
        assert inspect_log(log).usable
        counts.append(len(log))
    assert counts == sorted(counts)
    assert 0 < counts[0] < FRAMES
    assert counts[0] < counts[-1]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_recording_whose_end_alone_is_damaged_is_whole(tmp_path: Path, recording: Path, compression: CompressionType) -> None:
    data = rewritten(recording, tmp_path / "small.mcap", compression).read_bytes()
    (tmp_path / "end.mcap").write_bytes(data[:-37])  # without the footer, which says where the summary is
    log = open_log(tmp_path / "end.mcap")
    assert len(log) == FRAMES
    assert "an index, and what should follow at its end" in log.missing[0]


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_footer_that_takes_a_damaged_chunk_for_the_summary_is_not_believed(
    tmp_path: Path, recording: Path, compression: CompressionType
) -> None:
    data = bytearray(rewritten(recording, tmp_path / "small.mcap", compression).read_bytes())
    third = list(records_of(data, CHUNK))[2]
    data[-28:-20] = third.to_bytes(8, "little")  # where the footer says that the summary begins
    data[third + 60 : third + 600] = bytes(540)
    (tmp_path / "wrong.mcap").write_bytes(data)
    log = open_log(tmp_path / "wrong.mcap")
    assert 0 < len(log) < FRAMES
    assert log.missing


@pytest.mark.parametrize("place", [2**40, 2**63, 2**64 - 1])
def test_an_index_that_leads_beyond_the_file_is_told_in_one_line(tmp_path: Path, recording: Path, place: int) -> None:
    data = bytearray(rewritten(recording, tmp_path / "small.mcap", CompressionType.NONE).read_bytes())
    index = next(records_of(data, CHUNK_INDEX))
    data[index + 25 : index + 33] = place.to_bytes(8, "little")
    (tmp_path / "wrong.mcap").write_bytes(data)
    with pytest.raises(InputError, match=r"wrong\.mcap.*mcap recover") as caught:
        open_log(tmp_path / "wrong.mcap")
    assert caught.value.reason == "recording.damaged"


@pytest.mark.parametrize("chunked", [True, False])
def test_records_that_an_application_has_added_for_itself_are_passed_over(tmp_path: Path, recording: Path, chunked: bool) -> None:
    data = rewritten(recording, tmp_path / "small.mcap", CompressionType.NONE, chunked=chunked).read_bytes()
    after_header = 8 + 9 + int.from_bytes(data[9:17], "little")
    private = bytes([0x80]) + (5).to_bytes(8, "little") + b"ours!"
    (tmp_path / "private.mcap").write_bytes(data[:after_header] + private + data[after_header:-37])  # without the footer
    assert len(open_log(tmp_path / "private.mcap")) == FRAMES


def test_messages_outside_of_chunks_are_read(tmp_path: Path, recording: Path) -> None:
    log = open_log(rewritten(recording, tmp_path / "flat.mcap", CompressionType.NONE, chunked=False))
    assert len(log) == FRAMES
    np.testing.assert_array_equal(log.frame(3).right, made_frames(FRAMES, True)[3].right)
    assert log.gnss is not None


def test_a_recording_without_a_whole_message_is_refused(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "stub.mcap").write_bytes(recording.read_bytes()[:300])
    with pytest.raises(InputError, match=r"neither an index nor a whole message; .*mcap recover"):
        open_log(tmp_path / "stub.mcap")
