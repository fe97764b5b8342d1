"""Packs: many small files of a drive that come as one upload, one behind the other, each stored as if it had come alone.

A pack's files and their order are fixed when it is made, in an index beside the bytes. Files that are whole are moved to their
places in batches: renamed, made durable together, then their rows are committed with the number of the files that are done. What
lies behind that number is known by nothing but the file system, so whoever goes on looks there, and verifies it.
"""

import ctypes
import os
import sys
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Final, TypeVar

from sqlalchemy import Row, bindparam, select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store.database import now_s
from wayloom.store.drives import queue_if_complete
from wayloom.store.folders import Folders
from wayloom.store.jobs import JobMessage
from wayloom.store.tables.drives import Drive, DriveFile, Upload
from wayloom.store.uploads import Part, sync_folder

T = TypeVar("T")
MOST_FILES: Final = 10_000
"""Of one pack: a drive of more goes in several."""
LARGEST_PACKED: Final = 4 << 20
"""Bytes of one file of a pack, of which a request that continues it reads again what has come. A file of its own costs some 15 ms,
in which a pack moves as much."""
UNINDEXED_S: Final = 300.0
"""Until a pack expires whose index is not written."""
ROWS_AT_ONCE: Final = 500
FEW: Final = 4
"""So many files are made durable one by one, more of them with their file system."""


@dataclass(frozen=True, slots=True)
class PackedFile:
    """A file as the manifest promises it."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Pack:
    """The files of a pack in the order of their bytes, and where each begins; `starts` has one more: where the last one ends."""

    drive_id: str
    upload_id: str
    files: tuple[PackedFile, ...]
    starts: tuple[int, ...]

    def part(self, folders: Folders, number: int) -> Part:
        """What has arrived of a file."""
        return Part(folders.uploads / f"{self.upload_id}.{number}")

    def place(self, folders: Folders, number: int) -> Part:
        """Where a file belongs."""
        return Part(folders.drive(self.drive_id) / self.files[number].path)


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a pack's stored bytes end: so many files are whole, of the next one so many bytes are there."""

    files: int
    bytes: int


def lacking(session: Session, drive_id: str, paths: Sequence[str]) -> Sequence[PackedFile]:
    """Those of the files that have not arrived yet, in the order given. Raises NotFoundError, ConflictError."""
    found = {file.path: file for some in _batches(paths, ROWS_AT_ONCE) for file in _files(session, drive_id, some)}
    if unknown := [path for path in paths if path not in found]:
        raise NotFoundError(f"drive {drive_id[:12]!r} has no file {unknown[0][:200]!r} in its manifest")
    if len(found) < len(paths):
        raise ConflictError("a pack names each file once")
    if large := next((file for file in found.values() if file.size > LARGEST_PACKED), None):
        raise ConflictError(f"{large.path[:200]!r} has more than the {LARGEST_PACKED} bytes of a file of a pack: send it by itself")
    return [PackedFile(path, found[path].size, found[path].sha256) for path in paths if not found[path].complete]


def create(session: Session, drive_id: str, files: Sequence[PackedFile]) -> Upload:
    """A new pack of these files: to be indexed when the row is committed, since what has no row is swept away. Then it is to be
    prolonged: of a server that dies before that, nothing is left that counts as an open upload for days."""
    upload = Upload(
        id=uuid.uuid4().hex, drive_id=drive_id, path="", length=sum(file.size for file in files), metadata_header="",
        complete=False, expires_at=now_s(session) + UNINDEXED_S, files_done=0,
    )  # fmt: skip
    session.add(upload)
    return upload


def index_of(files: Sequence[PackedFile]) -> bytes:
    """What is written down of a pack: which files it has."""
    return "".join(f"{file.sha256} {file.size} {file.path}\n" for file in files).encode()


def indexed(upload: Upload, content: bytes) -> Pack:
    """The pack of an index."""
    files, starts = _parse(content)
    return Pack(upload.drive_id, upload.id, files, starts)


def index(folders: Folders, upload: Upload, files: Sequence[PackedFile]) -> Pack:
    """Write down which files a pack has."""
    folders.uploads.mkdir(parents=True, exist_ok=True)
    unfinished = folders.uploads / f"{upload.id}.new"
    unfinished.write_bytes(index_of(files))
    os.replace(unfinished, _place_of_index(folders, upload.id))
    return of(folders, upload)


def _files(session: Session, drive_id: str, paths: Sequence[str]) -> Sequence[Row[str, int, str, bool]]:
    clean = [path for path in paths if "\0" not in path]  # PostgreSQL takes no NUL in a text
    wanted = select(DriveFile.path, DriveFile.size, DriveFile.sha256, DriveFile.complete)  # objects cost more than the query
    return session.execute(wanted.where(DriveFile.drive_id == drive_id, DriveFile.path.in_(clean))).all()


def of(folders: Folders, upload: Upload) -> Pack:
    """The pack of an upload. Raises NotFoundError where its index is gone."""
    try:
        files, starts = _read(_place_of_index(folders, upload.id))
    except FileNotFoundError:
        raise NotFoundError("the pack's index is gone: start it again") from None
    return Pack(upload.drive_id, upload.id, files, starts)


def _place_of_index(folders: Folders, upload_id: str) -> Path:
    return folders.uploads / f"{upload_id}.pack"


@lru_cache(16)
def _read(index: Path) -> tuple[tuple[PackedFile, ...], tuple[int, ...]]:
    """An index; it is never changed after it is written."""
    return _parse(index.read_bytes())


def _parse(content: bytes) -> tuple[tuple[PackedFile, ...], tuple[int, ...]]:
    fields = (line.split(" ", 2) for line in content.decode().split("\n") if line)
    files = tuple(PackedFile(path, int(size), digest) for digest, size, path in fields)
    return files, tuple(accumulate((file.size for file in files), initial=0))


def stored(folders: Folders, pack: Pack, files_done: int) -> Progress:
    """How far a pack is. Files that are whole but have no committed row are read and verified: a power cut may have spoilt them."""
    for number in range(files_done, len(pack.files)):
        part, file = pack.part(folders, number), pack.files[number]
        come, there = part.size(), pack.place(folders, number)
        if come < file.size or (file.size == 0 and not part.path.exists()):
            if there.path.exists() and there.size() == file.size and there.digest() == file.sha256:
                part.drop()
                continue
            return Progress(number, come)
        if come > file.size or part.digest() != file.sha256:
            part.drop()
            return Progress(number, 0)
    return Progress(len(pack.files), 0)


def install(folders: Folders, pack: Pack, numbers: Sequence[int]) -> None:
    """Move whole files to their places and make them durable. Those that lie there already are made durable all the same."""
    home, parts = str(folders.drive(pack.drive_id)), f"{folders.uploads}/{pack.upload_id}."
    targets = [f"{home}/{pack.files[number].path}" for number in numbers]
    for folder in {os.path.dirname(target) for target in targets}:
        os.makedirs(folder, exist_ok=True)
    for number, target in zip(numbers, targets, strict=True):
        try:
            os.replace(f"{parts}{number}", target)
        except FileNotFoundError:  # it lies there
            continue
    make_durable(targets)


def mark_done(
    session: Session, pack: Pack, first: int, end: int, expiry_s: float, *, in_objects: bool = False
) -> JobMessage | None:
    """The files from `first` up to `end` are in their places: in the drive's folder, or in the parts of the pack itself. With the
    drive's last one its jobs begin, and the message of the first of them is returned. Raises NotFoundError where the drive was
    removed meanwhile."""
    drive = session.get(Drive, pack.drive_id, with_for_update=True)
    if drive is None:
        raise NotFoundError(f"drive {pack.drive_id[:12]} was removed while it was uploaded")
    if in_objects:
        _say_where(session, pack, first, end)
    for some in _batches(pack.files[first:end], ROWS_AT_ONCE):
        theirs = DriveFile.path.in_([file.path for file in some])
        session.execute(update(DriveFile).where(DriveFile.drive_id == pack.drive_id, theirs).values(complete=True))
    values = {"files_done": end, "expires_at": now_s(session) + expiry_s, "complete": end == len(pack.files)}
    session.execute(update(Upload).where(Upload.id == pack.upload_id).values(values))
    return queue_if_complete(session, drive)


def _say_where(session: Session, pack: Pack, first: int, end: int) -> None:
    """Of the files that have not arrived otherwise meanwhile."""
    lacking_ones = update(DriveFile).where(DriveFile.drive_id == pack.drive_id, DriveFile.complete.is_(False))
    these = lacking_ones.where(DriveFile.path == bindparam("of")).values(upload_id=pack.upload_id, upload_start=bindparam("at"))
    if rows := [{"of": pack.files[number].path, "at": pack.starts[number]} for number in range(first, end)]:
        session.connection().execute(these, rows)  # not through the session, which takes no such update


def drop(folders: Folders, upload_id: str) -> None:
    """Forget the bytes of a pack that have not come to their places, and its index."""
    for path in folders.uploads.glob(f"{upload_id}.*"):
        path.unlink(missing_ok=True)


def unfinished(session: Session, drive_id: str) -> Sequence[Upload]:
    """The packs of a drive that are not whole, oldest expiry first. One whose server died before it wrote the index cannot be
    continued."""
    query = select(Upload).where(Upload.drive_id == drive_id, Upload.complete.is_(False), Upload.expires_at > now_s(session))
    return session.scalars(query.where(Upload.files_done.is_not(None)).order_by(Upload.expires_at)).all()


def is_indexed(folders: Folders, upload_id: str) -> bool:
    """Whether a pack's index was written."""
    return _place_of_index(folders, upload_id).exists()


def _batches(all_of_them: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    return (all_of_them[start : start + size] for start in range(0, len(all_of_them), size))


def make_durable(files: Sequence[str | Path]) -> None:
    """Make files and their names durable. Many of them by one flush of their file system: a flush for each would take milliseconds
    a file, whatever its size."""
    if sys.platform == "linux" and len(files) > FEW:
        fd = os.open(os.path.dirname(files[0]), os.O_RDONLY | os.O_CLOEXEC)
        try:
            if _libc().syncfs(fd) != 0:
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        finally:
            os.close(fd)
        return
    for path in [*files, *sorted({os.path.dirname(file) for file in files})]:
        sync_folder(Path(path))


@lru_cache(1)
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
