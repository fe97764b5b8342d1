"""Repository of the audit log: entries are added and read, never changed."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from wayloom.store.tables.access import AuditEntry


@dataclass(frozen=True, slots=True)
class Noted:
    """An entry that is to be added; the fields are those of `AuditEntry`. at: seconds since 1970."""

    at: float
    actor: str
    role: str | None
    action: str
    object: str
    address: str
    status: int
    outcome: str
    count: int = 1


def append(session: Session, entries: Sequence[Noted]) -> None:
    """Add entries; texts are cut to their columns' lengths."""
    lengths = {column.name: getattr(column.type, "length", None) for column in AuditEntry.__table__.columns}
    session.execute(
        insert(AuditEntry), [{name: _cut(value, lengths[name]) for name, value in asdict(one).items()} for one in entries]
    )


def page(
    session: Session, limit: int, before: int | None = None, actor: str | None = None, outcome: str | None = None
) -> Sequence[AuditEntry]:
    """Entries, newest first, from before the one with this id on."""
    query = select(AuditEntry).order_by(AuditEntry.id.desc()).limit(limit)
    if before is not None:
        query = query.where(AuditEntry.id < before)
    if actor is not None:
        query = query.where(AuditEntry.actor == actor)
    if outcome is not None:
        query = query.where(AuditEntry.outcome == outcome)
    return session.scalars(query).all()


def _cut(value: Any, length: int | None) -> Any:
    return value.replace("\0", "")[:length] if isinstance(value, str) else value
