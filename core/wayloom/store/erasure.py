"""Erasure of a removed drive from what others keep: its vehicle, versions of its rig's file, words about it in other rows.

Rows of its own go with the drive, its submaps and tiles by `withdrawal`. This is the rest, in the same transaction.
"""

import json
from typing import Any, Final

from sqlalchemy import delete, exists, or_, select
from sqlalchemy.orm import Session

from wayloom.store.tables.drives import Drive, Job, Vehicle
from wayloom.store.tables.maps import MapVersion
from wayloom.store.tables.rigs import Rig, RigEvidence, RigVersion
from wayloom.store.withdrawal import forget_blobs

SHORT: Final = 12
"""Digits of an id by which messages name a drive."""
NOBODY: Final = "a removed drive"


def forget_rig(session: Session, drive_id: str) -> str | None:
    """Before the drive's rows go, and after its rig was learnt anew: the versions of the rig's file that were learnt from it.
    Returns the rig's id."""
    facts = session.get_one(Drive, drive_id).facts
    evidence = session.get(RigEvidence, drive_id)
    key = evidence.rig if evidence is not None else (facts.get("rig") or {}).get("rig")
    for version in session.scalars(select(RigVersion).where(RigVersion.rig == (key or ""))).all():
        if drive_id in version.drives:
            forget_blobs(session, [version.digest], "odometry")
            session.delete(version)
    session.flush()
    return key


def forget_names(session: Session, drive_id: str, map_id: str, vehicle_id: str | None, rig: str | None) -> None:
    """After the drive's rows are gone: its vehicle and its rig, where nothing else is known of them, and words of others that name
    it."""
    session.flush()
    named = exists().where(Drive.vehicle_id == Vehicle.id)
    session.execute(delete(Vehicle).where(Vehicle.id == (vehicle_id or ""), ~named))
    told = or_(exists().where(RigEvidence.rig == Rig.id), exists().where(RigVersion.rig == Rig.id), exists().where(_uses(Rig.id)))
    session.execute(delete(Rig).where(Rig.id == (rig or ""), ~told), execution_options={"synchronize_session": False})
    for version in session.scalars(select(MapVersion).where(MapVersion.map_id == map_id)):
        version.facts = unnamed(version.facts, drive_id)
    for drive in session.scalars(select(Drive).where(Drive.map_id == map_id, Drive.map_verdict.is_not(None))):
        drive.map_verdict = unnamed(drive.map_verdict, drive_id)
    for job in session.scalars(select(Job).where(Job.map_id == map_id)):
        job.error, job.message, job.losses = (unnamed(one, drive_id) for one in (job.error, job.message, job.losses))
    for failed in session.scalars(select(Drive).where(Drive.map_id == map_id, Drive.error.contains(drive_id[:SHORT]))):
        failed.error = unnamed(failed.error, drive_id)
    session.flush()


def unnamed(content: Any, drive_id: str) -> Any:
    """JSON without what names the drive: entries of lists and tables that are its id or under it go, in texts it is nobody.

    What does not name it is returned as it is, the same object.
    """
    if content is None or drive_id[:SHORT] not in json.dumps(content):
        return content
    if isinstance(content, dict):
        kept = {name: value for name, value in content.items() if drive_id not in (name, value)}
        return {name: unnamed(value, drive_id) for name, value in kept.items()}
    if isinstance(content, list):
        return [unnamed(value, drive_id) for value in content if value != drive_id and not _is_of(value, drive_id)]
    return str(content).replace(drive_id, NOBODY).replace(drive_id[:SHORT], NOBODY)


def _is_of(value: Any, drive_id: str) -> bool:
    """Whether an entry of a list is about the drive: a table or a list that has its id as a value."""
    return drive_id in (value.values() if isinstance(value, dict) else value if isinstance(value, list) else ())


def _uses(rig: Any) -> Any:
    """Of a drive: it was tracked with this rig's file, or asked for one."""
    return Drive.facts["rig"]["rig"].as_string() == rig
