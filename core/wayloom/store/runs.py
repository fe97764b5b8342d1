"""Repository of the runs of drives: which stages, code, networks and settings made the submaps that a drive had in the map."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from wayloom.store.database import now_s
from wayloom.store.tables.drives import Drive, DriveRun

BATCH = 400


def record(session: Session, drive: Drive, stages: Mapping[str, Any], submaps: Sequence[str]) -> None:
    """Write down the run that made these submaps; the same run again, as a job that is repeated, is written once."""
    before = newest(session, drive.id)
    about = {"stages": {**stages}, "submaps": [*submaps], "asked": (drive.coming or {}).get("asked", {})}
    if before is not None and {name: getattr(before, name) for name in about} == about:
        return
    number = 1 if before is None else before.number + 1
    session.add(DriveRun(drive_id=drive.id, number=number, created_at=now_s(session), **about))
    session.flush()


def newest(session: Session, drive_id: str) -> DriveRun | None:
    """The run whose submaps the map has, or has next; None of a drive that was processed before runs were kept."""
    of_drive = select(DriveRun).where(DriveRun.drive_id == drive_id)
    return session.scalars(of_drive.order_by(DriveRun.number.desc()).limit(1)).first()


def of_drives(session: Session, drive_ids: Collection[str]) -> dict[str, list[DriveRun]]:
    """For each drive its runs, newest first."""
    found: dict[str, list[DriveRun]] = {drive_id: [] for drive_id in drive_ids}
    ids = sorted(drive_ids)
    for start in range(0, len(ids), BATCH):
        rows = select(DriveRun).where(DriveRun.drive_id.in_(ids[start : start + BATCH])).order_by(DriveRun.number.desc())
        for row in session.scalars(rows):
            found[row.drive_id].append(row)
    return found


def that_made(runs: Sequence[DriveRun], submap: str, before_s: float) -> DriveRun | None:
    """Of a drive's runs, newest first, the one that a version of this time has the submap from."""
    made = [run for run in runs if submap in run.submaps]
    return next((run for run in made if run.created_at <= before_s), made[-1] if made else None)
