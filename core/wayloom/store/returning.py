"""Return of images that were deleted: the same files, sent once more."""

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError
from wayloom.store.database import now_s
from wayloom.store.images import DELETED, DELETING, KEPT, RETURNING
from wayloom.store.jobs import JobMessage, create_drive_jobs
from wayloom.store.tables.drives import Drive, DriveFile, Job


def ask_again(session: Session, drive: Drive) -> None:
    """Have all files of a drive sent once more, where they were deleted."""
    if drive.images == DELETING:
        raise ConflictError(f"the images of drive {drive.id[:12]} are being deleted: send them again in a minute")
    if drive.images == DELETED:
        drive.images, drive.images_since = RETURNING, now_s(session)
        session.execute(update(DriveFile).where(DriveFile.drive_id == drive.id).values(complete=False))


def returned(session: Session, drive: Drive) -> JobMessage | None:
    """All files have come once more: they are kept until the drive is published again. A drive that had failed begins anew; its
    first job's message is returned."""
    drive.images, drive.images_since, drive.uploaded_at = KEPT, None, now_s(session)
    if drive.state != "failed" or session.scalars(select(Job.id).where(Job.drive_id == drive.id).limit(1)).first() is not None:
        return None
    drive.state, drive.error, drive.finished_at = "queued", None, None
    return create_drive_jobs(session, drive.id)
