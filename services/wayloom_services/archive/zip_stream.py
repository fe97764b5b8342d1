"""Zip archive as a stream: made while it is sent, never whole in memory or on a disk."""

import io
import time
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

OF_A_FILE: Final = 0o100644 << 16
"""Of a regular file that its owner writes and all read, as the archive tells it."""
LEVEL: Final = 1
"""Of deflate: the archive is to be made about as fast as it is sent."""


@dataclass(frozen=True, slots=True)
class Member:
    """A file of the archive.

    blocks : its bytes, a part at a time
    about  : what it holds, in words
    packed : deflated; else as it is, what is packed already or of which the size is to be foreseen
    huge   : whether it may pass 4 GiB, which must be known before its first byte (Zip64)
    """

    name: str
    blocks: Iterable[bytes]
    about: str = ""
    packed: bool = True
    huge: bool = False


def zip_stream(members: Iterable[Member], at_s: float) -> Iterator[bytes]:
    """The archive's bytes, after each block of each member what it has led to.

    at_s : seconds since 1970, UTC; the time that all members bear. What a member raises ends the stream without the archive's
           directory, by which every reader sees that it is not whole.
    """
    sink, when = _Sink(), time.gmtime(max(at_s, 315_532_800.0))  # zip begins with 1980
    archive = zipfile.ZipFile(sink, "w", compresslevel=LEVEL)
    for member in members:
        info = zipfile.ZipInfo(member.name, when[:6])
        info.external_attr = OF_A_FILE
        info.compress_type = zipfile.ZIP_DEFLATED if member.packed else zipfile.ZIP_STORED
        info._compresslevel = LEVEL  # type: ignore[attr-defined]  # that of the archive is for members without ZipInfo
        with archive.open(info, "w", force_zip64=member.huge) as file:
            for block in member.blocks:
                file.write(block)
                yield sink.taken()
    archive.close()
    yield sink.taken()


class _Sink(io.RawIOBase):
    """Holds what was written since it was asked last. It has no way back, so that sizes follow the data."""

    def __init__(self) -> None:
        self._held = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:
        self._held += data
        return len(data)

    def taken(self) -> bytes:
        """The bytes, once."""
        found, self._held = bytes(self._held), bytearray()
        return found
