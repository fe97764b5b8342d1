"""Rows of the parts of uploads in an object store: which bytes of an upload have arrived, and what may be forgotten of them.

The rows are the truth. An object is stored first and told to the database then, behind the parts that stand there: whoever
continues an upload elsewhere meanwhile makes that fail, so two writers cannot mix their bytes. What no row names is an orphan.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Row, delete, func, select, update
from sqlalchemy.orm import Session

from wayloom.errors import NotFoundError
from wayloom.store.objects import Objects
from wayloom.store.tables.drives import DriveFile, Upload, UploadPart

BELOW: Final = "drives"
"""Prefix of all names: `drives/DRIVE/UPLOAD/START-…` is a part, `drives/DRIVE/UPLOAD/pack` a pack's index."""
READ_AHEAD: Final = 4


@dataclass(frozen=True, slots=True)
class StoredPart:
    """`length` bytes of an upload from `start` on: the first ones of the object `name`."""

    start: int
    length: int
    name: str


def folder_of(drive_id: str, upload_id: str) -> str:
    """The prefix of an upload's objects."""
    return f"{BELOW}/{drive_id}/{upload_id}"


def end_of(session: Session, upload_id: str) -> int:
    """The offset: how many bytes have arrived."""
    last = select(UploadPart.start + UploadPart.length).where(UploadPart.upload_id == upload_id)
    return session.scalars(last.order_by(UploadPart.start.desc()).limit(1)).first() or 0


def parts_of(session: Session, upload_id: str, start: int = 0) -> list[StoredPart]:
    """The parts in the order of their bytes, those that end before `start` left out."""
    wanted = select(UploadPart.start, UploadPart.length, UploadPart.name).where(UploadPart.upload_id == upload_id)
    behind = wanted.where(UploadPart.start + UploadPart.length > start)
    return [StoredPart(*row) for row in session.execute(behind.order_by(UploadPart.start))]


def add(session: Session, upload: Upload, part: StoredPart) -> None:
    """A part has been stored. Raises NotFoundError where the upload is gone, BlockingIOError where somebody else has gone on."""
    lock(session, upload)
    if end_of(session, upload.id) != part.start:
        raise BlockingIOError("another process has continued this upload")
    session.add(UploadPart(upload_id=upload.id, start=part.start, drive_id=upload.drive_id, length=part.length, name=part.name))
    session.flush()


def lock(session: Session, upload: Upload) -> None:
    """Keep others from the upload until the transaction ends. Raises NotFoundError where it is gone."""
    if session.get(Upload, upload.id, with_for_update=True, populate_existing=True) is None:
        raise NotFoundError("the upload was dropped meanwhile: start it again")


def cut(session: Session, upload_id: str, end: int) -> list[str]:
    """Forget the bytes from `end` on. Returns the names of the objects that nothing needs any more."""
    gone = delete(UploadPart).where(UploadPart.upload_id == upload_id, UploadPart.start >= end).returning(UploadPart.name)
    names = [*session.scalars(gone)]
    over = update(UploadPart).where(UploadPart.upload_id == upload_id, UploadPart.start + UploadPart.length > end)
    session.execute(over.values(length=end - UploadPart.start))
    return names


def release(session: Session, drive_id: str, upload_id: str) -> list[str]:
    """Give an upload up: what no complete file of its drive lies in is forgotten. Returns the names of its objects of no use."""
    of_upload = select(func.max(DriveFile.upload_start + DriveFile.size)).where(
        DriveFile.drive_id == drive_id, DriveFile.upload_id == upload_id, DriveFile.complete.is_(True)
    )
    return cut(session, upload_id, session.scalars(of_upload).one() or 0)


def forget_drive(session: Session, drive_id: str) -> list[str]:
    """Forget all parts of a drive. Returns the names of their objects, and of the packs' indexes that may be there."""
    gone = delete(UploadPart).where(UploadPart.drive_id == drive_id).returning(UploadPart.name)
    names = [*session.scalars(gone)]
    session.execute(update(DriveFile).where(DriveFile.drive_id == drive_id).values(upload_id=None, upload_start=None))
    packs = session.scalars(select(Upload.id).where(Upload.drive_id == drive_id, Upload.files_done.is_not(None)))
    return names + [f"{folder_of(drive_id, upload_id)}/pack" for upload_id in packs]


def given_up(session: Session, now: float) -> Sequence[Row[str, str]]:
    """Drive and id of the uploads with parts that have expired, or are forgotten, before they were whole; what is done of a pack
    is not asked after."""
    has_parts = select(UploadPart.drive_id, UploadPart.upload_id).distinct()
    known = has_parts.outerjoin(Upload, Upload.id == UploadPart.upload_id)
    expired = Upload.complete.is_(False) & (Upload.expires_at < now)
    used = select(DriveFile.path).where(
        DriveFile.drive_id == UploadPart.drive_id, DriveFile.upload_id == UploadPart.upload_id, DriveFile.complete.is_(True),
        DriveFile.upload_start + DriveFile.size > UploadPart.start,
    )  # fmt: skip
    return session.execute(known.where(expired | Upload.id.is_(None)).where(~used.exists())).all()


def orphans(session: Session, names: Sequence[str]) -> list[str]:
    """Those of the objects that no row names."""
    of_upload: dict[str, list[str]] = {}
    for name in names:
        if name.count("/") == 3 and name.startswith(f"{BELOW}/"):
            of_upload.setdefault(name.split("/")[2], []).append(name)
    ids = list(of_upload)
    named = set(session.scalars(select(UploadPart.name).where(UploadPart.upload_id.in_(ids))))
    open_packs = select(Upload.id).where(Upload.id.in_(ids), Upload.files_done.is_not(None), Upload.complete.is_(False))
    indexed = set(session.scalars(open_packs))
    return [
        name
        for upload_id, theirs in of_upload.items()
        for name in theirs
        if name not in named and not (name.endswith("/pack") and upload_id in indexed)
    ]


def read(objects: Objects, parts: Sequence[StoredPart], start: int) -> Iterator[bytes]:
    """The bytes of an upload from `start` on, part by part, some of them fetched ahead. Raises NotFoundError."""
    with ThreadPoolExecutor(READ_AHEAD) as fetchers:
        coming = [fetchers.submit(objects.get, part.name, part.length) for part in parts[:READ_AHEAD]]
        try:
            for number, part in enumerate(parts):
                content = coming.pop(0).result()
                if number + READ_AHEAD < len(parts):
                    following = parts[number + READ_AHEAD]
                    coming.append(fetchers.submit(objects.get, following.name, following.length))
                yield content[max(0, start - part.start) :]
        finally:
            for fetching in coming:
                fetching.cancel()
