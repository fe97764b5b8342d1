"""Files that a log should not hold: pictures that would not fit into memory, pipes, and files without an end."""

import os
import struct
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from wayloom.client.manifests import hash_file
from wayloom.errors import LogError
from wayloom.files import regular
from wayloom.files.text_files import read_bytes
from wayloom.logs.images.image_files import MOST_PIXELS, decode_image, read_header, read_image

SIDE = 30_000


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@pytest.fixture(scope="module")
def bomb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A right PNG of 30,000 × 30,000 grey pixels in 900 kB."""
    packer = zlib.compressobj(1)
    row = bytes(SIDE + 1)
    rows = b"".join(packer.compress(row) for _ in range(SIDE)) + packer.flush()
    file = tmp_path_factory.mktemp("bomb") / "0000000000.png"
    header = struct.pack(">IIBBBBB", SIDE, SIDE, 8, 0, 0, 0, 0)
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
    return file


READERS: dict[str, Callable[[Path], object]] = {
    "header": read_header,
    "grey": lambda file: read_image(file, colour=False),
    "colour": lambda file: read_image(file, colour=True),
    "message of a bag": lambda file: decode_image(file.read_bytes(), file, colour=None, record="message 7"),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_picture_of_very_many_pixels_is_refused_before_it_is_unpacked(bomb: Path, reader: str) -> None:
    started = time.process_time()
    with pytest.raises(LogError, match="30000 × 30000 pixels"):
        READERS[reader](bomb)
    assert time.process_time() - started < 0.5  # unpacking it alone takes longer


def test_a_jpeg_of_very_many_pixels_is_refused_by_its_header(tmp_path: Path) -> None:
    file = tmp_path / "a.jpg"
    file.write_bytes(b"\xff\xd8\xff\xc0\x00\x11\x08" + struct.pack(">HH", 60_000, 60_000) + b"\x03" + bytes(100) + b"\xff\xd9")
    for read in READERS.values():
        with pytest.raises(LogError, match="60000 × 60000 pixels"):
            read(file)
    assert MOST_PIXELS < 60_000**2


@pytest.mark.parametrize("read", [read_header, hash_file, READERS["grey"], lambda file: read_bytes(file, remedy="leave it out")])
def test_a_pipe_in_a_log_is_refused_and_not_waited_for(tmp_path: Path, read: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "0000000000.png")
    with pytest.raises(LogError, match="no regular file"):
        read(tmp_path / "0000000000.png")
    with pytest.raises(LogError, match="no regular file"):
        read(Path("/dev/zero"))


def test_a_file_that_would_not_fit_into_memory_is_refused_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    with file.open("wb") as stream:
        stream.truncate(3 << 30)  # a hole: it takes no disk
    started = time.process_time()
    with pytest.raises(LogError, match=f"{3 << 30} bytes, {regular.MOST_BYTES} are allowed"):
        read_bytes(file, remedy="shorten it")
    assert time.process_time() - started < 0.1
