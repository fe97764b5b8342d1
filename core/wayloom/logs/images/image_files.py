"""Image files of a drive log: listing and pairing, header checks without decoding, decoding with integrity checks.

OpenCV decodes a truncated PNG or JPEG into a picture that is grey from some row on and says nothing, so wholeness is checked here.
"""

import contextlib
import io
import itertools
import os
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar, overload

import cv2
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.regular import open_regular
from wayloom.files.text_files import read_bytes, reason_of
from wayloom.logs.types import Seen

Image = NDArray[np.uint8]
T = TypeVar("T")
R = TypeVar("R")
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_END = b"IEND\xaeB`\x82"
JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
TAIL_BYTES = 1024
FIRST_TRIED = 10
"""Images are looked at for their size until one is whole; a log whose first ten are not is no log."""
MOST_PIXELS = 1 << 27
"""Of one image: 134 million, ten times as many as a large camera takes."""
_CHUNK_NUMBER = struct.Struct(">I").unpack_from
# What cannot be decoded is told here, in one line; OpenCV's own lines would stand before it.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
COPY_AGAIN = "copy the file again from the vehicle, or leave the frame out"


class _CutHeaderError(LogError):
    """A JPEG whose header does not say its size."""


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """width and height in pixels; whether the picture has colour."""

    width: int
    height: int
    colour: bool


@dataclass(frozen=True, slots=True)
class FilesOf(Sequence[Path]):
    """Files of one folder, by their names: every stage holds those of a drive's images, and paths take several times as much."""

    folder: Path
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, at: int) -> Path: ...

    @overload
    def __getitem__(self, at: slice) -> "FilesOf": ...

    def __getitem__(self, at: int | slice) -> "Path | FilesOf":
        """A path that is made now, or some of the files."""
        return FilesOf(self.folder, self.names[at]) if isinstance(at, slice) else self.folder / self.names[at]

    def kept(self, rows: Iterable[int]) -> "FilesOf":
        """These files only, in this order."""
        return FilesOf(self.folder, tuple(self.names[row] for row in rows))

    def inside(self, root: Path) -> list[str]:
        """Their paths from a folder on; none where they are not in it."""
        if not self.folder.is_relative_to(root):
            return []
        parts = self.folder.relative_to(root).parts
        return ["/".join((*parts, name)) for name in self.names]


@dataclass(frozen=True, slots=True)
class ImagePairs:
    """Left and right image files of the same frames: numbers (the file's number, or its place where it has none), left, right."""

    numbers: tuple[int, ...]
    left: FilesOf
    right: FilesOf

    def __len__(self) -> int:
        return len(self.numbers)

    def kept(self, rows: Sequence[int]) -> "ImagePairs":
        """These pairs only, in this order."""
        return ImagePairs(tuple(self.numbers[row] for row in rows), self.left.kept(rows), self.right.kept(rows))


def has_files(folder: Path) -> bool:
    """Whether a folder is there and holds something."""
    try:
        return next(folder.iterdir(), None) is not None
    except OSError:
        return False


def list_images(folder: Path) -> dict[str, str]:
    """The names of a folder's images by stem, in order of their number. Raises LogError for no folder, two images of one stem."""
    try:
        names = [name for name in os.listdir(folder) if not name.startswith(".")]
    except FileNotFoundError:
        remedy = "a stereo log needs both cameras' images"
        raise LogError("no such folder", file=folder, remedy=remedy, reason="image.missing") from None
    except OSError as problem:
        what = f"cannot be listed ({problem.strerror})"
        raise LogError(what, file=folder, remedy="check its permissions", reason=reason_of(problem)) from None
    parted = [(stem, suffix) for stem, suffix in map(os.path.splitext, names) if suffix.lower() in IMAGE_SUFFIXES]
    by_stem: dict[str, str] = {}
    for stem, suffix in sorted(parted, key=lambda parts: (not parts[0].isdecimal(), parts[0].zfill(20), parts[1])):
        if stem in by_stem:
            remedy = f"remove it or {by_stem[stem]}"
            raise LogError(
                "a second image of the same frame", file=folder / (stem + suffix), remedy=remedy, reason="image.ambiguous"
            )
        by_stem[stem] = stem + suffix
    return by_stem


def pair_images(left_folder: Path, right_folder: Path) -> ImagePairs:
    """Pair left and right images by name. Raises LogError where there is none, or one stands alone (the first is named)."""
    left, right = list_images(left_folder), list_images(right_folder)
    if not left and not right:
        remedy = f"put images there ({', '.join(IMAGE_SUFFIXES)})"
        raise LogError("no images", file=left_folder, remedy=remedy, reason="image.missing")
    alone = [stem for stem in (*left, *right) if (stem in left) != (stem in right)]
    if alone:
        first = min(alone, key=lambda stem: stem.zfill(20))
        alone_in_left = first in left
        file = left_folder / left[first] if alone_in_left else right_folder / right[first]
        other = right_folder if alone_in_left else left_folder
        what = f"no partner in {other} ({len(left)} left and {len(right)} right images)"
        raise LogError(what, file=file, remedy="add the missing image or remove this one", reason="image.unpaired")
    numbers = tuple(int(stem) if stem.isdecimal() else i for i, stem in enumerate(left))
    in_right = tuple(right[stem] for stem in left)
    return ImagePairs(numbers, FilesOf(left_folder, tuple(left.values())), FilesOf(right_folder, in_right))


def read_header(file: Path) -> ImageHeader:
    """Size and colour of an image, from its first bytes where it is PNG or JPEG, which must also have an end.

    Raises LogError for an empty, truncated or foreign file.
    """
    try:
        with open_regular(file) as stream:
            start = stream.read(33)
            size = stream.seek(0, 2)
            stream.seek(max(0, size - TAIL_BYTES))
            tail = stream.read(TAIL_BYTES)
            if start.startswith(JPEG_START):
                _check_end(tail, JPEG_END, file, size)
                return _not_too_large(_jpeg_header(stream, file), file)
    except OSError as problem:
        what, remedy = f"cannot be read ({problem.strerror})", "check the file and its permissions"
        raise LogError(what, file=file, remedy=remedy, reason=reason_of(problem)) from None
    if size == 0:
        raise LogError("the image is empty (0 bytes)", file=file, remedy=COPY_AGAIN, reason="image.empty")
    if start.startswith(PNG_SIGNATURE):
        _check_end(tail if len(start) == 33 else b"", PNG_END, file, size)
        return _not_too_large(_png_header(start), file)
    picture = _decoded(read_bytes(file, remedy=COPY_AGAIN), cv2.IMREAD_ANYCOLOR, file)
    return ImageHeader(picture.shape[1], picture.shape[0], picture.ndim == 3)


def first_header(files: Sequence[Path]) -> ImageHeader:
    """The header of the first image that has one, of the first few. Raises the LogError of the first where there is none."""
    return first_that_can(read_header, files)


def first_that_can(read: Callable[[T], R], items: Iterable[T]) -> R:
    """What is read of the first of a few items that raises no LogError. Raises the first one's where all do."""
    refused: LogError | None = None
    for item in itertools.islice(items, FIRST_TRIED):
        try:
            return read(item)
        except LogError as problem:
            refused = refused or problem
    raise refused or LogError("no images")


def _png_header(start: bytes) -> ImageHeader:
    """Of the first 33 bytes."""
    return ImageHeader(int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big"), bool(start[25] & 2))


def _not_too_large(header: ImageHeader, file: Path, record: str | None = None) -> ImageHeader:
    """The header. Raises LogError where the picture would not fit into memory: a small file may unpack to a thousand times more."""
    if header.width * header.height > MOST_PIXELS:
        what = f"the image has {header.width} × {header.height} pixels, {MOST_PIXELS} in all are allowed"
        raise LogError(what, file=file, record=record, remedy="leave the frame out", reason="image.too_large")
    return header


def _check_end(tail: bytes, end: bytes, file: Path, size: int, record: str | None = None) -> None:
    if end not in tail:
        what = f"the image is truncated: it ends after {size} bytes without its end mark"
        raise LogError(what, file=file, record=record, remedy=COPY_AGAIN, reason="image.truncated")


def _jpeg_header(stream: BinaryIO, file: Path) -> ImageHeader:
    """Walk the segments to the start of frame (SOF0 … SOF15 without DHT, JPG and DAC), ISO 10918-1 B.2.2."""
    stream.seek(2)
    while True:
        marker = stream.read(4)
        if len(marker) < 4 or marker[0] != 0xFF:
            raise _CutHeaderError("the JPEG has no frame header", file=file, remedy=COPY_AGAIN, reason="image.truncated")
        if 0xC0 <= marker[1] <= 0xCF and marker[1] not in (0xC4, 0xC8, 0xCC):
            frame = stream.read(6)
            if len(frame) < 6:
                raise _CutHeaderError("the JPEG's frame header is cut", file=file, remedy=COPY_AGAIN, reason="image.truncated")
            return ImageHeader(int.from_bytes(frame[3:5], "big"), int.from_bytes(frame[1:3], "big"), frame[5] >= 3)
        stream.seek(max(0, int.from_bytes(marker[2:4], "big") - 2), 1)


def check_png(data: bytes, file: Path, record: str | None = None) -> list[tuple[bytes, memoryview]]:
    """The chunks of a PNG, kind and content. Raises LogError where one is cut or its CRC-32 is wrong; `record` says where in the
    file it lies."""
    view, chunks, at = memoryview(data), [], len(PNG_SIGNATURE)
    while True:
        end = at + 12 + (_CHUNK_NUMBER(data, at)[0] if at + 12 <= len(data) else len(data))
        if end > len(data):
            what = f"the image is truncated: it ends after {len(data)} bytes"
            raise LogError(what, file=file, record=record, remedy=COPY_AGAIN, reason="image.truncated")
        if isal_zlib.crc32(view[at + 4 : end - 4]) != _CHUNK_NUMBER(data, end - 4)[0]:
            where = f"byte {at}" if record is None else f"{record}, byte {at}"
            what = "the image is damaged: wrong check sum"
            raise LogError(what, file=file, record=where, remedy=COPY_AGAIN, reason="image.checksum")
        chunks.append((data[at + 4 : at + 8], view[at + 8 : end - 4]))
        if chunks[-1][0] == b"IEND":
            return chunks
        at = end


def read_image(file: Path, *, colour: bool) -> Image:
    """Decode to (h, w, 3) RGB or (h, w) grey, uint8. Raises LogError for an empty, truncated, damaged or foreign file."""
    return decode_image(read_bytes(file, remedy=COPY_AGAIN), file, colour=colour)


def decode_image(data: bytes, file: Path, *, colour: bool | None, record: str | None = None) -> Image:
    """The bytes of an image file to (h, w, 3) RGB or (h, w) grey, uint8; whichever it is where `colour` is None.

    file, record : where the bytes are from. Raises LogError for an empty, truncated, damaged or foreign image.
    """
    if not data:
        raise LogError("the image is empty (0 bytes)", file=file, record=record, remedy=COPY_AGAIN, reason="image.empty")
    _check_size(data, file, record)
    if data.startswith(PNG_SIGNATURE):
        from wayloom.logs.images import plain_png  # numba takes half a second to import, which those who decode nothing do without

        image = plain_png.decode(check_png(data, file, record), colour=colour)
        if image is not None:
            return image
    elif data.startswith(JPEG_START):
        _check_end(data[-TAIL_BYTES:], JPEG_END, file, len(data), record)
    flags = {None: cv2.IMREAD_ANYCOLOR, True: cv2.IMREAD_COLOR, False: cv2.IMREAD_GRAYSCALE}[colour]
    picture = _decoded(data, flags, file, record)
    if picture.ndim == 3:  # numpy's reversed view takes fifty times as long to copy
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
    return picture


def check_image(file: Path, seen: Seen | None = None) -> ImageHeader:
    """Size and colour of an image that can be decoded; raises LogError as `read_image`.

    Of a JPEG all is unpacked, but an eighth of the picture made; of a plain PNG all is unpacked and its filters looked at.
    seen : given the file's bytes
    """
    data = read_bytes(file, remedy=COPY_AGAIN)
    if seen is not None:
        seen(file, data)
    if data.startswith(JPEG_START):
        _check_end(data[-TAIL_BYTES:], JPEG_END, file, len(data))
        header = _not_too_large(_jpeg_header(io.BytesIO(data), file), file)
        _decoded(data, cv2.IMREAD_REDUCED_GRAYSCALE_8, file)
        return header
    if data.startswith(PNG_SIGNATURE):
        from wayloom.logs.images import plain_png

        _check_size(data, file)
        size = plain_png.size_of_whole(check_png(data, file))
        if size is not None:
            return ImageHeader(size[0], size[1], size[2] == 3)
    picture = decode_image(data, file, colour=None)
    return ImageHeader(picture.shape[1], picture.shape[0], picture.ndim == 3)


def _check_size(data: bytes, file: Path, record: str | None = None) -> None:
    """By the header alone, before anything is unpacked. What has no whole header is refused later, with what is wrong with it."""
    if data.startswith(PNG_SIGNATURE) and len(data) >= 33:
        _not_too_large(_png_header(data[:33]), file, record)
    elif data.startswith(JPEG_START):
        with contextlib.suppress(_CutHeaderError):
            _not_too_large(_jpeg_header(io.BytesIO(data), file), file, record)


def _decoded(data: bytes, flags: int, file: Path, record: str | None = None) -> Image:
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        picture = None
    if picture is None:
        what = "not an image that can be decoded"
        raise LogError(what, file=file, record=record, remedy=COPY_AGAIN, reason="image.undecodable")
    return np.asarray(picture, dtype=np.uint8)
