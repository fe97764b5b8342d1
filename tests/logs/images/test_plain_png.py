"""The decoder of plain PNG images against OpenCV's, for every filter, kind of block and kind of damage."""

import struct
import subprocess
import sys
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.errors import LogError
from wayloom.logs.images import plain_png
from wayloom.logs.images.image_files import check_png, decode_image, read_image
from wayloom.logs.images.plain_png import unpacked

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "real_clips.py"
RNG = np.random.default_rng(5)
SIGNATURE = b"\x89PNG\r\n\x1a\n"
STRATEGIES = {"default": zlib.Z_DEFAULT_STRATEGY, "huffman": zlib.Z_HUFFMAN_ONLY, "runs": zlib.Z_RLE, "fixed": zlib.Z_FIXED}


def chunk(kind: bytes, content: bytes) -> bytes:
    """A PNG chunk with its check sum."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(stream: bytes, shape: tuple[int, int], *, colour_type: int = 0, interlaced: int = 0, part: int = 1000) -> bytes:
    """A PNG of (h, w) with its stream in parts."""
    head = struct.pack(">IIBBBBB", shape[1], shape[0], 8, colour_type, 0, 0, interlaced)
    parts = [chunk(b"IDAT", stream[i : i + part]) for i in range(0, len(stream), part)]
    return SIGNATURE + chunk(b"IHDR", head) + b"".join(parts) + chunk(b"IEND", b"")


def packed(rows: bytes, level: int = 6, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    """A zlib stream."""
    packer = zlib.compressobj(level, zlib.DEFLATED, 15, 8, strategy)
    return packer.compress(rows) + packer.flush()


def filtered(filters: np.ndarray, width: int) -> bytes:
    """Rows of random bytes (most of them small) behind the given filters: some picture, whichever they stand for."""
    rows = np.minimum(RNG.geometric(0.05, (len(filters), width)), 255).astype(np.uint8)
    return np.column_stack([filters.astype(np.uint8), rows]).tobytes()


def written(tmp_path: Path, data: bytes) -> Path:
    """The bytes as a file."""
    file = tmp_path / "image.png"
    file.write_bytes(data)
    return file


@pytest.mark.parametrize("level", [0, 1, 6, 9])
@pytest.mark.parametrize("strategy", list(STRATEGIES))
def test_streams_of_every_kind_come_out_as_they_went_in(level: int, strategy: str) -> None:
    """Stored, fixed and dynamic blocks; literals, runs, far matches, codes longer than the table."""
    rare = np.minimum(RNG.geometric(0.5, 40000), 255)  # codes of up to 15 bits
    contents = [
        b"", b"a", bytes(70000), RNG.integers(0, 256, 70000, dtype=np.uint8).tobytes(), rare.astype(np.uint8).tobytes(),
        b"wayloom " * 5000, np.concatenate([rare, np.arange(256), rare[:30000]]).astype(np.uint8).tobytes(),
    ]  # fmt: skip
    for content in contents:
        assert unpacked(packed(content, level, STRATEGIES[strategy]), len(content)) == content


def by_opencv(data: bytes, colour: bool) -> np.ndarray:
    """What OpenCV reads, in RGB."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image[..., ::-1] if colour else image


@pytest.mark.parametrize("kind", [0, 1, 2, 3, 4])
def test_every_filter_is_undone_as_opencv_does(kind: int, tmp_path: Path) -> None:
    """In the first row and in others, of grey images and of those in colour."""
    for channels, colour_type in ((1, 0), (3, 2)):
        data = png(packed(filtered(np.full(40, kind), 67 * channels)), (40, 67), colour_type=colour_type)
        for colour in (False, True):
            assert np.array_equal(decode_image(data, tmp_path, colour=colour), by_opencv(data, colour))


def test_every_colour_has_the_grey_level_that_opencv_gives_it(tmp_path: Path) -> None:
    level = np.arange(0, 256, 3, dtype=np.uint8)
    rgb = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(len(level), -1, 3)
    data = cv2.imencode(".png", rgb)[1].tobytes()
    assert np.array_equal(decode_image(data, tmp_path, colour=False), by_opencv(data, False))


def test_an_image_comes_as_it_is_asked_for(tmp_path: Path) -> None:
    """Grey of colour and colour of grey; where neither is asked for, as it is stored."""
    for channels, colour_type in ((1, 0), (3, 2)):
        data = png(packed(filtered(RNG.integers(0, 5, 12), 9 * channels)), (12, 9), colour_type=colour_type)
        shapes = [decode_image(data, tmp_path, colour=colour).shape for colour in (False, True, None)]
        assert shapes == [(12, 9), (12, 9, 3), (12, 9) if channels == 1 else (12, 9, 3)]


@pytest.mark.parametrize(("channels", "colour_type", "colour"), [(1, 0, False), (3, 2, False), (3, 2, True)])
def test_mixed_filters_and_one_pixel_are_decoded(channels: int, colour_type: int, colour: bool, tmp_path: Path) -> None:
    """Rows of any filter after rows of any other, and the smallest picture."""
    for height, width in ((200, 51), (1, 1)):
        rows = filtered(RNG.integers(0, 5, height), width * channels)
        data = png(packed(rows), (height, width), colour_type=colour_type)
        found = plain_png.decode(check_png(data, tmp_path), colour=colour)
        assert found is not None
        assert np.array_equal(found, by_opencv(data, colour))
        assert plain_png.size_of_whole(check_png(data, tmp_path)) == (width, height, channels)


@pytest.mark.parametrize("row", [0, 5, 11])
def test_an_unknown_filter_is_left_to_opencv(row: int, tmp_path: Path) -> None:
    """Of grey images and of those in colour, in whichever row it stands."""
    for channels, colour_type in ((1, 0), (3, 2)):
        kinds = np.ones(12, np.int64)
        kinds[row] = 5
        chunks = check_png(png(packed(filtered(kinds, 9 * channels)), (12, 9), colour_type=colour_type), tmp_path)
        assert [plain_png.decode(chunks, colour=colour) for colour in (False, None)] == [None, None]
        assert plain_png.size_of_whole(chunks) is None


def test_what_is_not_plain_is_left_to_opencv(tmp_path: Path) -> None:
    """Transparency, 16 bits, interlaced pictures."""
    picture = RNG.integers(0, 256, (30, 40, 4), dtype=np.uint8)
    for image in (picture, picture[..., 0].astype(np.uint16) * 257):
        data = cv2.imencode(".png", image)[1].tobytes()
        assert plain_png.decode(check_png(data, tmp_path)) is None
        assert plain_png.size_of_whole(check_png(data, tmp_path)) is None
        for colour in (False, True):
            assert np.array_equal(decode_image(data, tmp_path, colour=colour), by_opencv(data, colour))
    data = png(packed(filtered(np.zeros(8), 8)), (8, 8), interlaced=1)
    assert plain_png.decode(check_png(data, tmp_path)) is None


def test_a_faulty_stream_is_never_read_beyond_its_ends() -> None:
    """Bytes changed at random: it fails or gives something else, of the right length; cut streams fail."""
    content = np.minimum(RNG.geometric(0.05, 5000), 255).astype(np.uint8).tobytes()
    stream = packed(content)
    for _ in range(1000):
        wrong = bytearray(stream)
        for at in RNG.integers(2, len(stream), 3):
            wrong[at] = RNG.integers(0, 256)
        found = unpacked(bytes(wrong), len(content))
        assert found is None or len(found) == len(content)
    for length in range(len(stream)):
        assert unpacked(stream[:length], len(content)) is None


@pytest.mark.parametrize("first", [0x07, 0x06])
def test_unknown_blocks_fail(first: int) -> None:
    """The reserved block kind."""
    assert unpacked(bytes([0x78, 0x9C, first, 0, 0, 0, 0, 0]), 10) is None


def test_a_stream_with_too_much_or_too_little_in_it_is_left_to_opencv(tmp_path: Path) -> None:
    """Which pads or cuts as ever."""
    rows = filtered(np.ones(20), 30)
    for content in (rows[:-5], rows + rows):
        chunks = check_png(png(packed(content), (20, 30)), tmp_path)
        assert plain_png.decode(chunks) is None
        assert plain_png.size_of_whole(chunks) is None


def test_a_stream_that_swells_beyond_its_header_is_stopped_there(tmp_path: Path) -> None:
    """64 MiB of zeros in 64 KiB, behind a header of 100 x 100 pixels."""
    chunks = check_png(png(packed(bytes(64 << 20), 9), (100, 100), part=1 << 20), tmp_path)
    tracemalloc.start()
    try:
        assert plain_png.decode(chunks) is None
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20


def test_damage_is_told_as_ever(tmp_path: Path) -> None:
    """Wrong check sums, cut files."""
    data = png(packed(filtered(np.ones(20), 30)), (20, 30))
    wrong = bytearray(data)
    wrong[60] ^= 1
    for damaged in (bytes(wrong), data[:-20], b""):
        with pytest.raises(LogError):
            read_image(written(tmp_path, damaged), colour=False)


@pytest.mark.parametrize(("width", "height"), [(2**31 - 1, 2**31 - 1), (2**31 - 1, 1000), (5, 0), (0, 5)])
def test_a_header_that_lies_is_left_to_opencv(width: int, height: int) -> None:
    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    stream = zlib.compress(b"")
    assert plain_png.decode([(b"IHDR", memoryview(header)), (b"IDAT", memoryview(stream))]) is None


def test_the_decoders_that_the_benchmark_compares_still_run_and_agree(clip_a: Path) -> None:
    command = [sys.executable, BENCHMARK, "--decoding", "--data", clip_a.parents[2]]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    ways = [line.split("|")[1].strip() for line in told.splitlines()[2:]]
    assert ways == ["isal, rows by a kernel", "zlib, rows by a kernel", "OpenCV"]
