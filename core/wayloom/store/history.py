"""History of a drive: each attempt at a stage, begun, done, failed, lost, with its error or evidence.

Rows of jobs tell of the last attempt alone.
"""

from collections.abc import Sequence
from typing import Final

from sqlalchemy import delete, insert, select
from sqlalchemy.orm import Session

from wayloom.store.database import now_s
from wayloom.store.tables.drives import DriveEvent

MOST: Final = 2000
"""Entries of a drive: the oldest go first. A drive of 200 parts that is tried three times has 1200."""
TEXT_LENGTH: Final = 4000
OFTEN: Final = ("waits", "back")
"""What may follow the begin of one attempt again and again, every few seconds: of the same in a row only the first is kept."""


def note_event(
    session: Session,
    drive_id: str | None,
    stage: str,
    what: str,
    *,
    part: int = 0,
    attempt: int = 0,
    text: str = "",
    worker: str | None = None,
) -> None:
    """Write down what happened to a stage of a drive; of a map's job, whose drive is None, nothing.

    what : begun, done, failed, again (it will be tried again), waits, lost, back (given back by a worker that stops), cancelled,
           asked (somebody wants it made anew)
    """
    if drive_id is None:
        return
    text = text.replace("\0", "")[:TEXT_LENGTH]
    if what in OFTEN and _is_repeated(session, drive_id, stage, part, (what, attempt, text)):
        return
    values = {"at": now_s(session), "stage": stage, "part": part, "attempt": attempt, "what": what, "worker": worker}
    session.execute(insert(DriveEvent).values(drive_id=drive_id, text=text, **values))


def _is_repeated(session: Session, drive_id: str, stage: str, part: int, entry: tuple[str, int, str]) -> bool:
    """Whether the last that is known of a stage is this entry, and after it at most that the same attempt begun once more, which
    is forgotten then. entry : what, attempt, text"""
    of_stage = (DriveEvent.drive_id == drive_id, DriveEvent.stage == stage, DriveEvent.part == part)
    newest = session.scalars(select(DriveEvent).where(*of_stage).order_by(DriveEvent.id.desc()).limit(2)).all()
    begun = next((row for row in newest[:1] if (row.what, row.attempt) == ("begun", entry[1])), None)
    last = newest[0 if begun is None else 1 :][:1]
    if [(row.what, row.attempt, row.text) for row in last] != [entry]:
        return False
    if begun is not None:
        session.execute(delete(DriveEvent).where(DriveEvent.id == begun.id))
    return True


def thin(session: Session, drive_id: str | None) -> None:
    """Forget the oldest entries of a drive that has more than MOST; of a map's job, whose drive is None, there are none."""
    if drive_id is None:
        return
    newest = select(DriveEvent.id).where(DriveEvent.drive_id == drive_id).order_by(DriveEvent.id.desc()).offset(MOST).limit(1)
    last = session.scalar(newest)
    if last is not None:
        session.execute(delete(DriveEvent).where(DriveEvent.drive_id == drive_id, DriveEvent.id <= last))


def of_drive(session: Session, drive_id: str, limit: int, before: int | None = None) -> Sequence[DriveEvent]:
    """Entries, newest first. before : ids below this one alone"""
    query = select(DriveEvent).where(DriveEvent.drive_id == drive_id)
    if before is not None:
        query = query.where(DriveEvent.id < before)
    return session.scalars(query.order_by(DriveEvent.id.desc()).limit(limit)).all()
