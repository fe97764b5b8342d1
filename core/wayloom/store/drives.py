"""Repository of drives and their files."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store.access.owners import Owner
from wayloom.store.database import now_s
from wayloom.store.erasure import forget_names, forget_rig
from wayloom.store.etas.told import forget_open
from wayloom.store.images import DELETING, RETURNING
from wayloom.store.jobs import JobMessage, create_drive_jobs, create_removal_job
from wayloom.store.manifest import Manifest
from wayloom.store.maps import ensure_map, mark_changed
from wayloom.store.returning import ask_again, returned
from wayloom.store.tables.drives import Drive, DriveFile, Job, Vehicle
from wayloom.store.withdrawal import forget_drive

ROWS_AT_ONCE: Final = 2000
"""Files that are written or read together: a drive may have 200,000."""


@dataclass(frozen=True, slots=True)
class Received:
    """How much of a drive has arrived and is verified."""

    files: int
    bytes: int


def register(
    session: Session, manifest: Manifest, map_id: str, owner: Owner | None = None, again: bool = False
) -> tuple[Drive, bool]:
    """The manifest's drive, and whether it is new.

    owner : the vehicle that announces it, where that is one
    again : where its images were deleted they are wanted once more

    Raises ConflictError where it is another's: who holds a manifest of so many hashes learns nothing by that.
    """
    drive_id = manifest.drive_id
    if (known := session.get(Drive, drive_id, with_for_update=True)) is not None:  # a sweeper may be about to delete its images
        if owner is not None and known.owner != owner.name:
            raise ConflictError(f"drive {drive_id[:12]} was announced by another key")
        if known.state == "removing":
            raise ConflictError(f"drive {drive_id[:12]} is being removed: send it again in a minute")
        if again:
            ask_again(session, known)
        return known, False
    now = now_s(session)
    ensure_map(session, map_id)
    vehicle_id = manifest.vehicle_id or (None if owner is None else owner.vehicle_id)
    if vehicle_id is not None and session.get(Vehicle, vehicle_id) is None:
        session.add(Vehicle(id=vehicle_id, created_at=now))
        session.flush()
    about = manifest.model_dump(mode="json", exclude={"files"})
    drive = Drive(
        id=drive_id, name=manifest.name, vehicle_id=vehicle_id, owner=None if owner is None else owner.name, map_id=map_id,
        manifest=about, state="uploading", facts={}, file_count=len(manifest.files), byte_count=manifest.byte_count, created_at=now,
    )  # fmt: skip
    session.add(drive)
    session.flush()
    files, rows_of = iter(manifest.files), session.connection()  # not through the session, which looks at each row's object
    while some := [*islice(files, ROWS_AT_ONCE)]:
        rows = [{"drive_id": drive_id, "complete": False, "path": one.path, "size": one.size, "sha256": one.sha256} for one in some]
        rows_of.execute(insert(DriveFile), rows)
    return drive, True


def get(session: Session, drive_id: str) -> Drive:
    """The drive, whatever its state. Raises NotFoundError."""
    drive = session.get(Drive, drive_id)
    if drive is None:
        raise NotFoundError(f"there is no drive {drive_id[:80]!r}")
    return drive


def shown(session: Session, drive_id: str) -> Drive:
    """The drive, to hand out what it has led to. Raises NotFoundError, also of one that is being removed."""
    drive = get(session, drive_id)
    if drive.state == "removing":
        raise NotFoundError(f"drive {drive_id[:12]} is being removed")
    return drive


def known(session: Session, drive_ids: Sequence[str]) -> set[str]:
    """Those of the ids that are drives."""
    return set(session.scalars(select(Drive.id).where(Drive.id.in_(drive_ids)))) if drive_ids else set()


def all_ids(session: Session) -> set[str]:
    """The ids of all drives."""
    return set(session.scalars(select(Drive.id)))


def newest(
    session: Session, limit: int, before: float | None = None, state: str | None = None, owner: str | None = None
) -> Sequence[Drive]:
    """Drives by the time of their registration, newest first; of one owner, where that is asked for."""
    query = select(Drive).order_by(Drive.created_at.desc(), Drive.id).limit(limit)
    if owner is not None:
        query = query.where(Drive.owner == owner)
    if before is not None:
        query = query.where(Drive.created_at < before)
    if state is not None:
        query = query.where(Drive.state == state)
    return session.scalars(query).all()


def missing_files(session: Session, drive_id: str, after: str = "", limit: int = ROWS_AT_ONCE) -> Sequence[tuple[str, int, str]]:
    """Path, size and SHA-256 of the next files that have not arrived yet, by path from behind `after` on."""
    query = select(DriveFile.path, DriveFile.size, DriveFile.sha256).where(DriveFile.drive_id == drive_id)
    open_ones = query.where(DriveFile.complete.is_(False), DriveFile.path > after)
    return [(path, size, digest) for path, size, digest in session.execute(open_ones.order_by(DriveFile.path).limit(limit))]


def received(session: Session, drives: Sequence[Drive]) -> dict[str, Received]:
    """For each drive, what has arrived. Files are counted only for those that may lack some: a drive has thousands."""
    open_ids = [drive.id for drive in drives if drive.uploaded_at is None or drive.images == RETURNING]
    query = select(DriveFile.drive_id, func.count(), func.sum(DriveFile.size)).where(
        DriveFile.drive_id.in_(open_ids), DriveFile.complete.is_(True)
    )
    counted = session.execute(query.group_by(DriveFile.drive_id)) if open_ids else ()
    whole = {drive.id: Received(drive.file_count, drive.byte_count) for drive in drives}
    return whole | dict.fromkeys(open_ids, Received(0, 0)) | {key: Received(count, int(size)) for key, count, size in counted}


def mark_complete(session: Session, drive_id: str, path: str, upload_id: str | None = None) -> JobMessage | None:
    """A file has arrived and is verified. When it was the last one the drive is queued, and the first job's message is returned.

    upload_id : the upload in whose parts in an object store it lies
    """
    drive = session.get(Drive, drive_id, with_for_update=True)
    if drive is None:
        raise NotFoundError(f"drive {drive_id[:12]} was removed while it was uploaded")
    one = update(DriveFile).where(DriveFile.drive_id == drive_id, DriveFile.path == path, DriveFile.complete.is_(False))
    where = {} if upload_id is None else {"upload_id": upload_id, "upload_start": 0}
    session.execute(one.values(complete=True, **where))
    return queue_if_complete(session, drive)


def queue_if_complete(session: Session, drive: Drive) -> JobMessage | None:
    """Start the drive's jobs when all of its files are there and they have not been started: not while these are being deleted,
    after which they are asked for again."""
    if drive.images == DELETING:
        return None
    if drive.images == RETURNING and not missing_any(session, drive.id):
        return returned(session, drive)
    if drive.state != "uploading" or missing_any(session, drive.id):
        return None
    drive.state, drive.uploaded_at = "queued", now_s(session)
    return create_drive_jobs(session, drive.id)


def missing_any(session: Session, drive_id: str) -> bool:
    """Whether a file has not arrived yet."""
    query = select(DriveFile.path).where(DriveFile.drive_id == drive_id, DriveFile.complete.is_(False)).limit(1)
    return session.scalars(query).first() is not None


def request_removal(session: Session, drive_id: str) -> JobMessage:
    """Take the drive out of everything that is yet to run; a job then removes its files and its part of the map."""
    drive = get(session, drive_id)
    if drive.state == "removing":
        raise ConflictError(f"drive {drive_id[:12]} is being removed already")
    session.execute(delete(Job).where(Job.drive_id == drive_id))
    forget_open(session, drive_id)
    mark_changed(session, drive_id)  # a stitch may run before the removal does
    drive.state, drive.error = "removing", None
    return create_removal_job(session, drive_id)


def delete_rows(session: Session, drive_id: str) -> None:
    """Forget the drive, its files, uploads, jobs, runs and submaps, and what names it elsewhere; the map has changed where these
    were. Its blobs are to go, and so are the versions of the map that hold it, but for the newest, which the next one replaces."""
    drive = get(session, drive_id)
    map_id, vehicle_id = drive.map_id, drive.vehicle_id
    mark_changed(session, drive_id)
    rig = forget_rig(session, drive_id)
    forget_drive(session, drive_id)
    session.execute(delete(Drive).where(Drive.id == drive_id))
    forget_names(session, drive_id, map_id, vehicle_id, rig)


def jobs_of(session: Session, drives: Sequence[Drive]) -> dict[str, list[Job]]:
    """For each drive its stages in order, with their parts, those of the map job that takes it in included."""
    ids = [drive.id for drive in drives]
    map_jobs = {drive.id: _map_job(drive) for drive in drives}
    stitches = {job_id for job_id in map_jobs.values() if job_id is not None}
    own = session.scalars(select(Job).where(Job.drive_id.in_(ids)).order_by(Job.position, Job.part)).all()
    of_map = session.scalars(select(Job).where(Job.id.in_(stitches) | Job.parent_id.in_(stitches)).order_by(Job.id)).all()
    found: dict[str, list[Job]] = {drive_id: [] for drive_id in ids}
    for job in own:
        if job.drive_id is not None:
            found[job.drive_id].append(job)
    for drive_id, map_job in map_jobs.items():
        if map_job is not None:
            found[drive_id] += [job for job in of_map if map_job in (job.id, job.parent_id)]
    return found


def _map_job(drive: Drive) -> int | None:
    """The map's job that takes in what the drive's stages make; of a drive that is processed anew, none until they are done."""
    return drive.stitch_job_id if drive.coming is None else drive.coming.get("stitch")


def track_of(session: Session, drive_id: str) -> list[object] | None:
    """(M, 3) longitude, latitude, height of the drive, None until it has a place."""
    return get(session, drive_id).track
