"""Deletion of images whose time is over: after the version that has their drive, or at a greatest age.

Any number of sweepers may run at once, and be killed at any point. Three steps: the drive is marked, in a transaction that makes
sure that no job of it is to run; its folders are renamed into the trash, in the transaction that says so, so that no late sweeper
takes what was sent once more; the trash is emptied. What lies in an object store is deleted when no row names it any more.
"""

import os
import shutil
import uuid
from pathlib import Path
from typing import Final

from sqlalchemy import ColumnElement, and_, delete, exists, false, func, null, or_, select, update
from sqlalchemy.orm import Session

from wayloom.config.retention import UploadSettings
from wayloom.store import gate
from wayloom.store.database import Database, now_s
from wayloom.store.drive_files import FETCHED, DriveFiles
from wayloom.store.folders import Folders
from wayloom.store.images import DELETED, DELETING, KEPT, RETURNING
from wayloom.store.manifest import FOLDERS
from wayloom.store.receiving import parts
from wayloom.store.tables.drives import Drive, DriveFile, Job, Upload
from wayloom.store.tables.maps import MapDrive

OF_IMAGES: Final = ("stages/segmentation", "stages/labelling", "stages/odometry", "parts", "attempts")
"""What stages made of single images and the map does not read: classes of pixels, points with their grey values."""
DAY_S: Final = 86_400.0
AT_ONCE: Final = 20
"""Drives of one look: a sweeper has other things to do."""


def delete_due(database: Database, folders: Folders, settings: UploadSettings, files: DriveFiles | None = None) -> int:
    """Delete the images whose time is over, those in an object store by `files`. Returns of how many drives."""
    count = 0
    if settings.retention != "keep":
        with database.read() as session:
            due = session.scalars(select(Drive.id).where(_is_due(now_s(session), settings)).limit(AT_ONCE)).all()
        for drive_id in due:
            with database.write() as session:
                _mark(session, drive_id, settings)
    with database.read() as session:
        marked = session.scalars(select(Drive.id).where(Drive.images == DELETING)).all()
    for drive_id in marked:
        with database.write() as session:
            is_out = _move_out(session, folders, drive_id)
            names = parts.forget_drive(session, drive_id) if is_out else []
        count += is_out
        if files is not None:
            files.forget(names)
    for left in folders.trash.glob("*"):
        shutil.rmtree(left, ignore_errors=True)
    return count


def _is_due(now: float, settings: UploadSettings) -> ColumnElement[bool]:
    """Of a drive: its images are over, and no job of it is to run."""
    days = 0.0 if settings.retention == "until-published" else float(settings.retention)  # "keep" is not asked
    at_work = exists().where(Job.drive_id == Drive.id, Job.state.in_(("queued", "running", "waiting")))
    held = exists().where(MapDrive.map_id == Drive.map_id, MapDrive.drive_id == Drive.id, MapDrive.until.is_(None))
    in_map = and_(Drive.state == "done", Drive.coming.is_(null()), held, Drive.finished_at >= Drive.uploaded_at)
    published = and_(in_map, Drive.finished_at <= now - DAY_S * days)
    since = now - DAY_S * settings.held_days
    sent = exists().where(Upload.drive_id == Drive.id, Upload.complete.is_(False), Upload.expires_at > now)
    arriving = or_(Drive.state == "uploading", Drive.images == RETURNING)
    tried = exists().where(Job.drive_id == Drive.id, Job.finished_at >= since)
    ended = and_(Drive.state.in_(("done", "held", "quarantined", "failed")), func.coalesce(Drive.finished_at, 0.0) < since, ~tried)
    old = and_(ended, ~func.coalesce(in_map, false()), func.coalesce(Drive.uploaded_at, 0.0) < since)
    given_up = and_(arriving, func.coalesce(Drive.images_since, Drive.created_at) < since, ~sent)
    return and_(Drive.images.in_((KEPT, RETURNING)), ~at_work, or_(and_(Drive.images == KEPT, or_(published, old)), given_up))


def _mark(session: Session, drive_id: str, settings: UploadSettings) -> None:
    """Mark the drive, if its images are still due now that nobody can change it."""
    if session.get(Drive, drive_id) is None:
        return
    drive = gate.lock(session, drive_id)
    if session.scalars(select(Drive.id).where(Drive.id == drive_id, _is_due(now_s(session), settings))).first() is None:
        return
    _give_up_failed_run(session, drive)
    drive.images = DELETING


def _give_up_failed_run(session: Session, drive: Drive) -> None:
    """What a failed stage would need goes: the result before stays, a first run begins anew when the log comes again."""
    failed = select(Job.id).where(Job.drive_id == drive.id, Job.state == "failed").limit(1)
    if session.scalars(failed).first() is not None:
        session.execute(delete(Job).where(Job.drive_id == drive.id))
        drive.coming = None


def _move_out(session: Session, folders: Folders, drive_id: str) -> bool:
    """Rename what goes into the trash, and write down that it is gone."""
    drive = session.get(Drive, drive_id, with_for_update=True, populate_existing=True)
    if drive is None or drive.images != DELETING:
        return False  # another sweeper was faster
    folders.trash.mkdir(parents=True, exist_ok=True)
    (folders.drive(drive_id) / FETCHED).unlink(missing_ok=True)
    for name in (*FOLDERS, *OF_IMAGES):
        _into(folders.trash, folders.drive(drive_id) / name)
    arrives = drive.state == "uploading"
    session.execute(update(DriveFile).where(DriveFile.drive_id == drive_id).values(complete=not arrives))
    drive.images = KEPT if arrives else DELETED  # of a drive that never arrived nothing is there: it may be sent again
    drive.images_since = now_s(session)
    return True


def _into(trash: Path, folder: Path) -> None:
    if folder.is_dir():
        os.rename(folder, trash / uuid.uuid4().hex)
