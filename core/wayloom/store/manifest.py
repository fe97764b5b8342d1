"""The manifest of a drive: what a vehicle says it is about to send. Its hash is the drive's id."""

import hashlib
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator
from typing import Annotated, Self

import rfc8785
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, field_validator, model_validator

PLAIN = re.compile(r"[ -~]*")
USUAL = re.compile(r"(log|gnss)(/[\w.-]{0,254}[\w-])+", re.ASCII)
"""What most paths are: letters, digits, `_`, `-` and inner dots; no part longer than allowed. Nothing is wrong with them."""
INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
MAX_PATH = 1024
MAX_NAME_BYTES = 255
FOLDERS = ("log", "gnss")
"""A file of the drive log lies under `log/`, a file of a GNSS log kept beside it under `gnss/`."""

_TEXT = json.JSONEncoder(ensure_ascii=False)
Digest = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]


class PathError(ValueError):
    """A path that cannot be taken. `code` is stable: unsafe-path, path-too-long, duplicate-path."""

    def __init__(self, code: str, what: str) -> None:
        super().__init__(what)
        self.code = code


class ManifestFile(BaseModel):
    """One file: its path in the drive (forward slashes), bytes, SHA-256."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    path: str = Field(max_length=MAX_PATH)
    size: int = Field(ge=0, lt=2**53, strict=True)
    sha256: Digest

    @field_validator("path")
    @classmethod
    def _safe(cls, path: str) -> str:
        return check_path(path)


class Manifest(BaseModel):
    """A drive before its bytes are there.

    name        short name for people
    log         the log inside the drive: `log`, or a folder or file below it
    gnss        the GNSS log kept beside it, under `gnss/`, if any
    format      the log's format where the sender knows it; a hint only
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str = Field(min_length=1, max_length=256)
    vehicle_id: str | None = Field(None, min_length=1, max_length=128)
    format: str | None = Field(None, max_length=64)
    log: str = Field("log", max_length=MAX_PATH)
    gnss: str | None = Field(None, max_length=MAX_PATH)
    files: tuple[ManifestFile, ...] = Field(min_length=1)

    @field_validator("name", "vehicle_id", "format")
    @classmethod
    def _printable(cls, text: str | None) -> str | None:
        if text is not None and not text.isprintable():
            raise ValueError("control characters are not allowed")
        return text

    @field_validator("log", "gnss")
    @classmethod
    def _safe(cls, path: str | None) -> str | None:
        return None if path is None else check_path(path, may_be_root=True)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _check_collisions(file.path for file in self.files)
        _check_inside("log", self.log, self.files)
        if self.gnss is not None:
            _check_inside("gnss", self.gnss, self.files)
        return self

    @property
    def drive_id(self) -> str:
        """SHA-256 of the manifest as canonical JSON (RFC 8785), files sorted by path, absent fields left out."""
        digest = hashlib.sha256()
        for part in self._canonical_parts():
            digest.update(part)
        return digest.hexdigest()

    @property
    def byte_count(self) -> int:
        """Bytes of all files together."""
        return sum(file.size for file in self.files)

    def canonical(self) -> bytes:
        """The bytes that the drive's id is the hash of."""
        return b"".join(self._canonical_parts())

    def _canonical_parts(self) -> Iterator[bytes]:
        """A file at a time: a drive may have 200,000. `files` comes first of the names in use."""
        about = rfc8785.dumps(self.model_dump(exclude_none=True, exclude={"files"}))
        yield b'{"files":['
        for number, file in enumerate(sorted(self.files, key=lambda file: file.path)):
            path = _TEXT.encode(file.path)
            yield f'{"," if number else ""}{{"path":{path},"sha256":"{file.sha256}","size":{file.size}}}'.encode()
        yield b"]," + about[1:]


def check_path(path: str, *, may_be_root: bool = False) -> str:
    """The path if it can safely be a file in a drive's folder. Raises PathError that says what is wrong."""
    return path if USUAL.fullmatch(path) else check_parts(path, may_be_root=may_be_root)


def check_parts(path: str, *, may_be_root: bool = False) -> str:
    """The same of any path, part by part."""
    parts = path.split("/")
    if "\\" in path or (not PLAIN.fullmatch(path) and any(unicodedata.category(letter) in INVISIBLE for letter in path)):
        raise PathError("unsafe-path", f"{path!r}: control characters and backslashes are not allowed in a path")
    if any(part in ("", ".", "..") for part in parts):
        raise PathError("unsafe-path", f"{path!r}: a path is relative, without empty, '.' or '..' parts")
    if any(len(part.encode()) > MAX_NAME_BYTES for part in parts):
        raise PathError("path-too-long", f"{path[:80]!r}…: a part of the path has more than {MAX_NAME_BYTES} bytes")
    if any(part != part.strip() or part.endswith(".") or ":" in part for part in parts):
        raise PathError("unsafe-path", f"{path!r}: a part of the path has a colon, or starts or ends with a space or dot")
    if parts[0] not in FOLDERS or (len(parts) == 1 and not may_be_root):
        raise PathError("unsafe-path", f"{path!r}: a path starts with {' or '.join(folder + '/' for folder in FOLDERS)}")
    return path


def _check_collisions(paths: Iterable[str]) -> None:
    """Refuse two files that one file system would take for one, and a file that is another's folder."""
    seen: dict[str, str] = {}
    for path in paths:
        folded = _folded(path)
        if folded in seen:
            raise PathError("duplicate-path", f"{path!r} and {seen[folded]!r} are the same file on some file systems")
        seen[folded] = path
    for folder in {folded.rpartition("/")[0] for folded in seen}:
        while folder:
            if folder in seen:
                raise PathError("duplicate-path", f"{seen[folder]!r} is both a file and the folder of another")
            folder = folder.rpartition("/")[0]


def _folded(path: str) -> str:
    return path.lower() if path.isascii() else unicodedata.normalize("NFKC", path).casefold()


def _check_inside(folder: str, path: str, files: tuple[ManifestFile, ...]) -> None:
    if path.split("/")[0] != folder:
        raise ValueError(f"{folder} is {path!r}, which is not under {folder}/")
    if not any(file.path == path or file.path.startswith(path + "/") for file in files):
        raise ValueError(f"{folder} is {path!r}, but no file of the manifest lies there")
