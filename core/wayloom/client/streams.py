"""Streams of bytes, each sent as one resumable upload: one file, or a pack of small ones, one behind the other."""

import base64
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, Protocol

from wayloom.client.api import Api
from wayloom.client.chunks import Chunk, Span
from wayloom.client.manifests import hash_file
from wayloom.errors import LogError

TUS: Final = {"Tus-Resumable": "1.0.0"}


class Stream(Protocol):
    """A resumable upload. `length` may shrink when it is created: what has arrived meanwhile is left out."""

    length: int

    def create(self, api: Api) -> str | None:
        """Begin it without a byte: of one whose answer is lost nothing is lost. Returns its address; None where nothing is left."""

    def chunk(self, offset: int, count: int) -> Chunk:
        """Its bytes from `offset` on, at most so many."""

    def files_before(self, offset: int) -> int:
        """How many of its files end at or before `offset`."""

    def check_unchanged(self, offset: int) -> None:
        """Raise LogError where the file at `offset` is not what was announced any more: it would be sent and refused for ever."""


class OneFile:
    """A file as the registration lists it."""

    def __init__(self, drive_id: str, file: dict[str, Any], source: Path) -> None:
        self._drive_id, self._file, self._source = drive_id, file, source
        self.length = int(file["size"])

    def create(self, api: Api) -> str | None:
        named = f"drive {_base64(self._drive_id)},path {_base64(self._file['path'])}"
        headers = {**TUS, "Upload-Length": str(self.length), "Upload-Metadata": named}
        address = str(api.once("POST", "/v1/uploads", headers=headers).headers["Location"])
        return address if self.length else None

    def chunk(self, offset: int, count: int) -> Chunk:
        return Chunk((Span(self._source, offset, min(count, self.length - offset), self.length),))

    def files_before(self, offset: int) -> int:
        return int(offset == self.length)

    def check_unchanged(self, offset: int) -> None:
        _check(self._file, self._source)


class PackOfFiles:
    """Files as the registration lists them. Those that have arrived when the pack is made are left out."""

    def __init__(self, drive_id: str, files: Sequence[dict[str, Any]], sources: dict[str, Path]) -> None:
        self._drive_id, self._sources = drive_id, sources
        self._hold(files)

    def _hold(self, files: Sequence[dict[str, Any]]) -> None:
        self._files = list(files)
        self._starts = list(accumulate((int(file["size"]) for file in files), initial=0))
        self.length = self._starts[-1]

    def create(self, api: Api) -> str | None:
        paths = [file["path"] for file in self._files]
        begun = api.once("POST", f"/v1/drives/{self._drive_id}/packs", json={"paths": paths}).json()
        skipped = set(begun["skipped"])
        self._hold([file for file in self._files if file["path"] not in skipped])
        address: str | None = begun["upload"]
        return address

    def chunk(self, offset: int, count: int) -> Chunk:
        spans, number = [], bisect_right(self._starts, offset) - 1
        end = min(offset + count, self.length)
        while offset < end:
            size, begins = int(self._files[number]["size"]), self._starts[number]
            come = min(begins + size, end) - offset
            if come:
                spans.append(Span(self._sources[self._files[number]["path"]], offset - begins, come, size))
            offset, number = offset + come, number + 1
        return Chunk(tuple(spans))

    def files_before(self, offset: int) -> int:
        return bisect_right(self._starts, offset, lo=1) - 1

    def check_unchanged(self, offset: int) -> None:
        number = min(bisect_right(self._starts, offset) - 1, len(self._files) - 1)
        _check(self._files[number], self._sources[self._files[number]["path"]])


def _check(file: dict[str, Any], source: Path) -> None:
    if hash_file(source) != (file["size"], file["sha256"]):
        raise LogError("has changed since it was announced", file=source, remedy="run the command again")


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
