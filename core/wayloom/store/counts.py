"""Counts of jobs, drives and map versions for the operator's metrics."""

from collections.abc import Sequence

from sqlalchemy import func, select

from wayloom.store.database import Session
from wayloom.store.tables.drives import Drive, Job
from wayloom.store.tables.maps import Map


def jobs(session: Session) -> Sequence[tuple[str, str, int]]:
    """(stage, state, how many)."""
    return session.execute(select(Job.stage, Job.state, func.count()).group_by(Job.stage, Job.state)).all()


def drives(session: Session) -> Sequence[tuple[str, int]]:
    """(state, how many)."""
    return session.execute(select(Drive.state, func.count()).group_by(Drive.state)).all()


def maps(session: Session) -> Sequence[tuple[str, int]]:
    """(map, its published version)."""
    return session.execute(select(Map.id, Map.version)).all()
