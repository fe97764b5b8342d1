"""Queries of the list of drives: filtered, searched, sorted, a page at a time, with counts by state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, func, or_, select
from sqlalchemy.orm import Session

from wayloom.store.tables.drives import Drive

SORTS: Final[Mapping[str, tuple[Any, ...]]] = {
    "newest": (Drive.created_at.desc(),),
    "oldest": (Drive.created_at,),
    "name": (func.lower(Drive.name), Drive.created_at.desc()),
    "vehicle": (func.coalesce(Drive.vehicle_id, ""), Drive.created_at.desc()),
    "grade": (func.coalesce(Drive.grade, "").desc(), Drive.created_at.desc()),
}
"""Orders of the list; the id breaks ties, so that pages neither repeat nor skip a drive."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Which drives: of one owner, registered before a time (s since 1970), in a state, of a vehicle, with a text in their name or
    vehicle, or at the start of their id."""

    owner: str | None = None
    before: float | None = None
    state: str | None = None
    vehicle: str | None = None
    search: str | None = None

    def conditions(self) -> list[ColumnElement[bool]]:
        """All that must hold of a row."""
        found: list[ColumnElement[bool]] = []
        if self.owner is not None:
            found.append(Drive.owner == self.owner)
        if self.before is not None:
            found.append(Drive.created_at < self.before)
        if self.state is not None:
            found.append(Drive.state == self.state)
        if self.vehicle is not None:
            found.append(Drive.vehicle_id == self.vehicle)
        if self.search:
            found.append(_holds(self.search.lower()))
        return found


def _holds(text: str) -> ColumnElement[bool]:
    in_words = (func.lower(column).contains(text, autoescape=True) for column in (Drive.name, Drive.vehicle_id))
    return or_(*in_words, Drive.id.startswith(text, autoescape=True))


def page(session: Session, asked: Asked, sort: str, limit: int, offset: int) -> Sequence[Drive]:
    """The drives of one page. sort : a key of SORTS."""
    query = select(Drive).where(*asked.conditions()).order_by(*SORTS[sort], Drive.id).limit(limit).offset(offset)
    return session.scalars(query).all()


def count(session: Session, asked: Asked) -> int:
    """How many drives there are of those."""
    return session.scalar(select(func.count()).select_from(Drive).where(*asked.conditions())) or 0


def states(session: Session, owner: str | None) -> dict[str, int]:
    """How many drives are in each state, of one owner where that is asked for."""
    query = select(Drive.state, func.count().label("number")).where(*Asked(owner).conditions()).group_by(Drive.state)
    return {row.state: row.number for row in session.execute(query)}
