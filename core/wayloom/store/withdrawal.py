"""Withdrawal of what held a removed drive: versions of its map, and blobs.

A removed drive leaves the map with the next version. The versions before it that held the drive are withdrawn in the same
transaction, earlier ones when the drive is removed: what their rows name goes, but for rows that a version without the drive
shares, and their blobs are written down as forgotten, to be deleted as soon as nothing names them (`garbage.drop_forgotten`).
"""

from collections.abc import Iterable
from typing import Any, Final

from sqlalchemy import ColumnElement, delete, exists, or_, select, update
from sqlalchemy.orm import Session

from wayloom.store.database import now_s
from wayloom.store.tables.drives import Drive, SubmapRow  # fmt: skip
from wayloom.store.tables.maps import ForgottenBlob, Map, MapDrive, MapVersion, MeetingRow, RegionRow, TileRow  # fmt: skip
from wayloom.store.tables.rigs import RigEvidence  # fmt: skip

BATCH: Final = 200
NOTHING: Final = ""
"""The digest of a tile that no version shows any more, and of meetings that were not looked for."""


def forget_drive(session: Session, drive_id: str) -> None:
    """Before a drive's rows go: its blobs, and the versions that hold it, but for the newest, which the next one replaces."""
    drive = session.get_one(Drive, drive_id)
    of_drive = select(SubmapRow.digest).where(SubmapRow.drive_id == drive_id)
    forget_blobs(session, session.scalars(of_drive), "objects")
    forget_blobs(session, (one["preview"] for one in _facts(drive) if "preview" in one), "objects")
    forget_blobs(session, (one["quality"] for one in _facts(drive) if "quality" in one), "georeference")
    for row in session.scalars(select(RigEvidence).where(RigEvidence.drive_id == drive_id)):
        forget_blobs(session, (row.digest, row.own_digest), "odometry")
    session.execute(update(MapDrive).where(MapDrive.drive_id == drive_id).values(removed=True))
    withdraw(session, drive.map_id)


def forget_meetings(session: Session, map_id: str, drive_id: str) -> None:
    """What the drive had in common with others."""
    either = or_(MeetingRow.drive_a == drive_id, MeetingRow.drive_b == drive_id)
    here = (MeetingRow.map_id == map_id, either)
    forget_blobs(session, session.scalars(select(MeetingRow.digest).where(*here, MeetingRow.digest != NOTHING)), "stitch")
    session.execute(delete(MeetingRow).where(*here))


def withdraw(session: Session, map_id: str) -> list[int]:
    """Withdraw every version but the newest that holds a removed drive. Returns their numbers."""
    ended = or_(MapDrive.until.is_(None), MapDrive.until > MapVersion.version)
    span = (MapDrive.map_id == map_id, MapDrive.removed.is_(True), MapDrive.since <= MapVersion.version, ended)
    return withdraw_versions(session, map_id, exists().where(*span))


def withdraw_versions(session: Session, map_id: str, which: ColumnElement[bool]) -> list[int]:
    """Withdraw those of the versions but the newest that are served. Returns their numbers."""
    session.flush()
    newest = select(Map.version).where(Map.id == map_id).scalar_subquery()
    here = (MapVersion.map_id == map_id, MapVersion.withdrawn_at.is_(None), MapVersion.version < newest)
    found = session.scalars(select(MapVersion).where(*here, which).order_by(MapVersion.version)).all()
    for version in found:
        version.withdrawn_at, version.facts, version.bounds = now_s(session), {}, None
    session.flush()
    if found:
        _drop_rows(session, map_id)
    return [version.version for version in found]


def forget_blobs(session: Session, digests: Iterable[str], stage: str) -> None:
    """Have these blobs, which jobs of a stage store, deleted as soon as nothing names them."""
    wanted = sorted({*digests})
    for start in range(0, len(wanted), BATCH):
        some = wanted[start : start + BATCH]
        known = set(session.scalars(select(ForgottenBlob.digest).where(ForgottenBlob.digest.in_(some))))
        session.add_all(ForgottenBlob(digest=digest, stage=stage) for digest in some if digest not in known)
        session.flush()


def _drop_rows(session: Session, map_id: str) -> None:
    """The rows that belong to no version that is served. Of tiles the addresses stay, for the list of what a version changed."""
    of_region = (RegionRow.digest, RegionRow.ground, RegionRow.markings, RegionRow.areas, RegionRow.objects)
    named_by: tuple[tuple[type[TileRow | RegionRow], Any], ...] = (
        (TileRow, TileRow.digest),
        *((RegionRow, named) for named in of_region),
    )
    for table, named in named_by:
        digests = session.scalars(select(named).where(*_unserved(map_id, table)).distinct())
        forget_blobs(session, (digest for digest in digests if digest != NOTHING), "stitch")
    quietly = {"synchronize_session": False}
    session.execute(update(TileRow).where(*_unserved(map_id, TileRow)).values(digest=NOTHING, size=0), execution_options=quietly)
    for shared in (RegionRow, MapDrive):
        session.execute(delete(shared).where(*_unserved(map_id, shared)), execution_options=quietly)
    session.expire_all()


def _unserved(map_id: str, table: type[TileRow | RegionRow | MapDrive]) -> tuple[ColumnElement[bool], ...]:
    """Of rows that versions share: all of these are withdrawn or forgotten."""
    within = (MapVersion.version >= table.since, MapVersion.version < table.until)
    served = exists().where(MapVersion.map_id == map_id, MapVersion.withdrawn_at.is_(None), *within)
    return table.map_id == map_id, table.until.is_not(None), ~served


def _facts(drive: Drive) -> list[dict[str, Any]]:
    return [drive.facts, (drive.coming or {}).get("facts", {})]
