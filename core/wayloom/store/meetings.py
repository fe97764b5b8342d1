"""Repository of the meetings of drives: what their registrations found, pair by pair."""

from collections.abc import Collection, Sequence

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from wayloom.store.tables.drives import Drive
from wayloom.store.tables.maps import MeetingRow
from wayloom.store.withdrawal import forget_meetings

BATCH = 400


def of_drives(session: Session, map_id: str, drive_ids: Collection[str]) -> list[MeetingRow]:
    """The pairs that one of these drives is of, by their ids; drives that are gone may be among them."""
    found: dict[tuple[str, str], MeetingRow] = {}
    ids = sorted(drive_ids)
    for start in range(0, len(ids), BATCH):
        some = ids[start : start + BATCH]
        either = or_(MeetingRow.drive_a.in_(some), MeetingRow.drive_b.in_(some))
        rows = session.scalars(select(MeetingRow).where(MeetingRow.map_id == map_id, either))
        found |= {(row.drive_a, row.drive_b): row for row in rows}
    return [found[pair] for pair in sorted(found)]


def component(session: Session, map_id: str, drive_ids: Collection[str]) -> list[MeetingRow]:
    """The pairs with meetings that hang together with these drives, over any number of others."""
    known: set[str] = set()
    rows: dict[tuple[str, str], MeetingRow] = {}
    todo = set(drive_ids)
    while todo:
        known |= todo
        found = [row for row in of_drives(session, map_id, todo) if row.count]
        rows |= {(row.drive_a, row.drive_b): row for row in found}
        todo = {drive_id for row in found for drive_id in (row.drive_a, row.drive_b)} - known
    return [rows[pair] for pair in sorted(rows)]


def keep(session: Session, rows: Sequence[MeetingRow]) -> None:
    """Write pairs, in the place of what was known of them."""
    for row in rows:
        session.merge(row)


def forget_gone(session: Session, map_id: str, drive_ids: Collection[str]) -> None:
    """Drop the pairs of those of the drives that are not there any more."""
    there = set(session.scalars(select(Drive.id).where(Drive.id.in_(sorted(drive_ids)))))
    for gone in sorted(set(drive_ids) - there):
        forget_meetings(session, map_id, gone)
