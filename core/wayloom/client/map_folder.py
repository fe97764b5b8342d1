"""Folder that holds a version of a map as static files, and the account of what lies in it.

LAYER/z/x/y.ext           the tiles
LAYER/tilejson.json       TileJSON of each layer; its address of tiles is relative to this file
SHA256SUMS                digest and path of every tile, as `sha256sum --check` reads it
manifest.json             the version, and which part of it; written last
.wayloom-sync/            account.tsv: a line of JSON with version and part, then digest, size and time stamp of each tile;
                          incoming/: tiles that have come and are not in their places yet, by digest; lock
"""

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wayloom.errors import InputError
from wayloom.files.atomic import remove_unfinished, write_atomically

MANIFEST: Final = "manifest.json"
SUMS: Final = "SHA256SUMS"
TILE_JSON: Final = "tilejson.json"
ACCOUNT: Final = ".wayloom-sync"
TABLE: Final = "account.tsv"
FORMAT: Final = "wayloom-map-folder 1"


@dataclass(frozen=True, slots=True)
class HeldFile:
    """A tile that was put into the folder: digest, and by what it is seen that nobody has changed it since."""

    digest: str
    size: int
    mtime_ns: int


@dataclass(frozen=True, slots=True)
class Account:
    """A version that a folder holds, which part of it, and its tiles by path."""

    version: int
    part: Mapping[str, Any]
    tiles: Mapping[str, HeldFile]


class MapFolder:
    """The folder; only one process at a time may change it (`locked`)."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._account = root / ACCOUNT
        self._incoming = self._account / "incoming"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep others away. Raises InputError where another process has the folder, or where something else is there."""
        if self.root.exists() and not self.root.is_dir():
            raise InputError("is a file", file=self.root, remedy="give a folder")
        self._incoming.mkdir(parents=True, exist_ok=True)
        with (self._account / "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError("is being synchronised by another process", file=self.root, remedy="wait until it ends") from None
            remove_unfinished(self.root)
            yield

    def account(self) -> Account | None:
        """What the folder held when it was last whole; None where that is not known: what lies here is looked at then."""
        try:
            head, *lines = (self._account / TABLE).read_text(encoding="utf-8").splitlines()
            about: dict[str, Any] = json.loads(head)
            tiles = {}
            for line in lines:
                path, digest, size, mtime = line.split("\t")
                tiles[path] = HeldFile(digest, int(size), int(mtime))
            return Account(int(about.pop("version")), about, tiles)
        except (FileNotFoundError, ValueError, KeyError):
            return None

    def digest_of(self, path: str, held: HeldFile | None) -> str | None:
        """Of the file that lies there: as it was put, or, where it was touched since, of its bytes; None where there is none."""
        try:
            stat = (self.root / path).stat()
            if held is not None and (stat.st_size, stat.st_mtime_ns) == (held.size, held.mtime_ns):
                return held.digest
            return self.hash_of(path)
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None

    def hash_of(self, path: str) -> str:
        """SHA-256 of the file's bytes."""
        with (self.root / path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def has_come(self, digest: str) -> bool:
        """Whether the bytes lie among those that are not in their places yet."""
        file = self._incoming / digest
        return file.is_file() and hashlib.sha256(file.read_bytes()).hexdigest() == digest

    def take(self, digest: str, content: bytes) -> None:
        """Keep bytes that have come until they are put in their places."""
        write_atomically(self._incoming / digest, content)

    def put(self, paths: Mapping[str, str]) -> None:
        """Put bytes that have come in their places, digests by path; each file in one step."""
        left: dict[str, int] = {}
        for digest in paths.values():
            left[digest] = left.get(digest, 0) + 1
        for path, digest in sorted(paths.items()):
            left[digest] -= 1
            self._make_way(path)
            if left[digest]:
                write_atomically(self.root / path, (self._incoming / digest).read_bytes())
            else:
                os.replace(self._incoming / digest, self.root / path)

    def drop(self, paths: Iterable[str]) -> None:
        """Delete files, and folders that they leave empty."""
        for path in paths:
            file = self.root / path
            with suppress(FileNotFoundError, NotADirectoryError):
                file.unlink()
            for folder in file.parents:
                if folder == self.root:
                    break
                try:
                    folder.rmdir()
                except OSError:
                    break

    def close(
        self, tiles: Mapping[str, str], version: int, part: Mapping[str, Any], about: Mapping[str, Any],
        tile_json: Mapping[str, Mapping[str, Any]],
    ) -> None:  # fmt: skip
        """Write down what lies here now: tiles by path with their digests, the part of the version, what else the manifest tells
        about it, and the TileJSON of each layer. The manifest comes last."""
        lines = [json.dumps({"version": version, **part}, sort_keys=True)]
        for path, digest in sorted(tiles.items()):
            stat = (self.root / path).stat()
            lines.append(f"{path}\t{digest}\t{stat.st_size}\t{stat.st_mtime_ns}")
        for layer, said in tile_json.items():
            write_atomically(self.root / layer / TILE_JSON, _text(said))
        write_atomically(self.root / SUMS, "".join(f"{digest}  {path}\n" for path, digest in sorted(tiles.items())).encode())
        write_atomically(self._account / TABLE, "\n".join(lines).encode())
        write_atomically(self.root / MANIFEST, _text({"format": FORMAT, "version": version, **part, **about}))
        shutil.rmtree(self._incoming, ignore_errors=True)

    def strays(self, known: Iterable[str]) -> list[str]:
        """Paths of the files that are neither known nor the folder's own, sorted."""
        ours = {*known, MANIFEST, SUMS}
        found = []
        for folder, names, files in os.walk(self.root):
            if Path(folder) == self.root and ACCOUNT in names:
                names.remove(ACCOUNT)
            found += [(Path(folder) / name).relative_to(self.root).as_posix() for name in files]
        return sorted({*found} - ours)

    def _make_way(self, path: str) -> None:
        """The folder of a file, and nothing but a file, or nothing, in its place."""
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.is_dir():
            raise InputError("is a folder, where a tile belongs", file=file, remedy="move it away")


def _text(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, sort_keys=True) + "\n").encode()
