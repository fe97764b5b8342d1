"""Folder of what a stage made of each submap: `index.json` that lists them, and their content by its SHA-256."""

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically

INDEX: Final = "index.json"


class OfSubmap(Protocol):
    """What is kept: bytes, their SHA-256, and the digest of the submap that they are of."""

    @property
    def submap(self) -> str: ...
    @property
    def digest(self) -> str: ...
    @property
    def encoded(self) -> bytes: ...


T = TypeVar("T", bound=OfSubmap)


@dataclass(frozen=True, slots=True)
class SubmapFolder(Generic[T]):
    """A kind of such folders.

    format, version  of the index; entries: its list; entry: the digest in each of its entries
    suffix           of the files of content; decode: the content of bytes, with their file's name for its errors
    words, remedy    for errors: what an index is of, and what to do
    """

    format: str
    version: int
    entries: str
    entry: str
    suffix: str
    decode: Callable[[bytes, str], T]
    words: str
    remedy: str

    def save(self, found: Iterable[T], folder: Path) -> None:
        """Write them as they come, one in memory at a time, then the index: a folder with an index is whole."""
        folder.mkdir(parents=True, exist_ok=True)
        entries = []
        for one in found:
            write_atomically(self.file(folder, one.digest), one.encoded)
            entries.append({"submap": one.submap, self.entry: one.digest})
        text = json.dumps({"format": self.format, "version": self.version, self.entries: entries}, indent=1, sort_keys=True)
        write_atomically(folder / INDEX, text.encode())

    def file(self, folder: Path, digest: str) -> Path:
        """Where the content of this digest lies."""
        return folder / f"{digest}{self.suffix}"

    def read_index(self, folder: Path) -> dict[str, str]:
        """The digest for each submap's digest, in the order of the road. Raises InputError."""
        path = folder / INDEX
        try:
            index = json.loads(path.read_text(encoding="utf-8"))
            if index["format"] != self.format or index["version"] != self.version:
                raise ValueError(f"it is no {self.format} of version {self.version}")
            return {str(entry["submap"]): str(entry[self.entry]) for entry in index[self.entries]}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"is no index of {self.words} ({error})", file=path, remedy=self.remedy) from error

    def load(self, folder: Path, digest: str) -> T:
        """One of them. Raises InputError where it is missing or damaged."""
        path = self.file(folder, digest)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=self.remedy) from error
        if hashlib.sha256(data).hexdigest() != digest:
            raise InputError("does not hold what its name says", file=path, remedy=self.remedy)
        return self.decode(data, str(path))
