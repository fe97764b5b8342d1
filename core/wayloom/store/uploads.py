"""Repository of tus uploads: the row (which file of which drive, until when) and the stored bytes, whose number is the offset."""

import errno
import hashlib
import os
import shutil
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy import delete, or_, select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store.database import now_s
from wayloom.store.folders import Folders
from wayloom.store.tables.drives import DriveFile, Upload

BLOCK = 1 << 20
FOR_WRITING: Final = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
DISK_BLOCK = 4096
"""Bytes of which writing past the page cache wants multiples."""


@dataclass(frozen=True, slots=True)
class Part:
    """The bytes of one upload on disk. Every method is blocking: call it from a thread."""

    path: Path

    def size(self) -> int:
        """The offset: how many bytes are stored."""
        try:
            return os.stat(self.path).st_size
        except FileNotFoundError:
            return 0

    def open(self) -> int:
        """A file descriptor for writing, made with its folder where it is missing."""
        try:
            return os.open(self.path, FOR_WRITING, 0o640)
        except FileNotFoundError:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            return os.open(self.path, FOR_WRITING, 0o640)

    def digest(self) -> str:
        """SHA-256 of the stored bytes."""
        if self.size() == 0:
            return hashlib.sha256().hexdigest()
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def append(self, staged: "Part") -> None:
        """Put the bytes of `staged` behind ours and drop it. A crash on the way leaves a verified beginning of them."""
        if self.size() == 0:
            os.replace(staged.path, self.path)
            return
        with staged.path.open("rb") as source, self.path.open("ab") as target:
            shutil.copyfileobj(source, target, BLOCK)
        staged.drop()

    def install(self, target: Path) -> None:
        """Make the bytes durable and move them to their place."""
        fd = self.open()
        try:
            os.fdatasync(fd) if hasattr(os, "fdatasync") else os.fsync(fd)
        finally:
            os.close(fd)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(self.path, target)
        sync_folder(target.parent)

    def drop(self) -> None:
        """Forget the bytes."""
        self.path.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make the folder's names durable, so that no row says that a file is there which a power cut takes away."""
    fd = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def open_past_cache(path: Path) -> int | None:
    """A file descriptor that writes to the disk and not to the page cache; None where the file system has none."""
    if not hasattr(os, "O_DIRECT"):
        return None
    try:
        return os.open(path, os.O_WRONLY | os.O_DIRECT | os.O_CLOEXEC)
    except OSError:
        return None


def write_past_cache(direct: int | None, fd: int, data: memoryview, offset: int) -> None:
    """As `write_at`, of whole blocks in memory that begins at a page past the page cache, by `direct`; of all else through it."""
    written, whole = 0, len(data) - len(data) % DISK_BLOCK
    if direct is not None and whole and offset % DISK_BLOCK == 0:
        try:
            written = os.pwrite(direct, data[:whole], offset)
        except OSError as error:
            if error.errno != errno.EINVAL:  # the disk has larger blocks, or the memory does not begin at a page
                raise
    write_at(fd, data[written:], offset + written)


def write_at(fd: int, data: bytes | memoryview, offset: int) -> None:
    """Write all of `data` at `offset`."""
    view = memoryview(data)
    while view:
        written = os.pwrite(fd, view, offset)
        view, offset = view[written:], offset + written


def part(folders: Folders, upload_id: str) -> Part:
    """Where an upload's bytes are."""
    return Part(folders.uploads / f"{upload_id}.part")


def staged_part(folders: Folders, upload_id: str) -> Part:
    """Where a chunk waits for its checksum."""
    return Part(folders.uploads / f"{upload_id}.chunk")


def place_of(folders: Folders, upload: Upload) -> Part:
    """Where the upload's file belongs."""
    return Part(folders.drive(upload.drive_id) / upload.path)


def stored_bytes(folders: Folders, upload: Upload) -> int:
    """The offset. A file that lies whole in its place, but whose row did not come to be committed, has arrived all the same."""
    if upload.complete:
        return upload.length
    come = part(folders, upload.id).size()
    return upload.length if come < upload.length == place_of(folders, upload).size() else come


def settle(folders: Folders, upload: Upload, expected: str, running: str | None) -> str:
    """Bring a whole file to its place and return its SHA-256; one that is not as expected stays nowhere.

    The row is committed after it. Whatever happens between the two, the file is found again: in its part, or in its place.

    running : the digest that was taken while the bytes came, where there is one: they are not read again
    """
    come, place = part(folders, upload.id), place_of(folders, upload)
    lies_there = come.size() < upload.length
    found = place.digest() if lies_there else running or come.digest()
    if found != expected:
        (place if lies_there else come).drop()
    elif not lies_there:
        come.install(place.path)
    return found


def create(session: Session, drive_id: str, path: str, length: int, metadata: str, expiry_s: float) -> Upload:
    """A new upload of a file that a drive's manifest names. Raises NotFoundError, ConflictError."""
    file = session.get(DriveFile, (drive_id, path)) if "\0" not in drive_id + path else None  # PostgreSQL takes no NUL in a text
    if file is None:
        raise NotFoundError(f"drive {drive_id[:12]!r} has no file {path[:200]!r} in its manifest")
    if file.complete:
        raise ConflictError(f"{path} has arrived already")
    if file.size != length:
        raise ConflictError(f"{path}: the manifest says {file.size} bytes, Upload-Length says {length}")
    upload = Upload(
        id=uuid.uuid4().hex, drive_id=drive_id, path=path, length=length, metadata_header=metadata, complete=False,
        expires_at=now_s(session) + expiry_s,
    )  # fmt: skip
    session.add(upload)
    return upload


def find(session: Session, upload_id: str) -> Upload:
    """The upload. Raises NotFoundError."""
    upload = session.get(Upload, upload_id) if upload_id.isalnum() else None
    if upload is None:
        raise NotFoundError("there is no such upload, or it was dropped")
    return upload


def promised(session: Session, upload: Upload) -> DriveFile:
    """What the manifest promises for the upload's file, and whether it has arrived."""
    return session.get_one(DriveFile, (upload.drive_id, upload.path))


def prolong(session: Session, upload_id: str, expiry_s: float) -> float:
    """Count the expiry from now. Returns when it will be."""
    until = now_s(session) + expiry_s
    session.execute(update(Upload).where(Upload.id == upload_id).values(expires_at=until))
    return until


def mark_complete(session: Session, upload_id: str) -> None:
    """The file is in its place."""
    session.execute(update(Upload).where(Upload.id == upload_id).values(complete=True))


def remove(session: Session, upload_id: str) -> None:
    """Forget the row."""
    session.execute(delete(Upload).where(Upload.id == upload_id))


def unfinished(session: Session, drive_id: str) -> Sequence[Upload]:
    """The uploads of a drive that can be continued."""
    query = select(Upload).where(Upload.drive_id == drive_id, Upload.complete.is_(False), Upload.expires_at > now_s(session))
    return session.scalars(query).all()


def drop_expired(session: Session, folders: Folders, grace_s: float = 3600.0) -> int:
    """Drop the bytes of uploads that have expired or have no row, as when their drive was removed meanwhile. Returns the rows gone.

    The row of an unfinished upload stays for `grace_s`, so a late client hears 410, not 404.
    """
    now = now_s(session)
    stored = list(folders.uploads.glob("*.*"))  # before the rows are read: a row is always older than its file
    if stored:
        open_ids = set(session.scalars(select(Upload.id).where(Upload.complete.is_(False), Upload.expires_at >= now)))
        for path in stored:
            if path.stem not in open_ids:
                path.unlink(missing_ok=True)
    of_no_use = or_(Upload.complete.is_(True), Upload.expires_at < now - grace_s)
    gone = delete(Upload).where(Upload.expires_at < now, of_no_use).returning(Upload.id)
    return len(session.scalars(gone).all())
