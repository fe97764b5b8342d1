"""How long stages usually took, which the time that a drive will still take is told by."""

import pytest

from wayloom.store.database import Database
from wayloom.store.etas.told import usual_seconds
from wayloom.store.tables.drives import Job


def add(database: Database, stage: str, state: str, seconds: float | None, count: int = 1) -> None:
    with database.write() as session:
        for _ in range(count):
            finished = None if seconds is None else 100.0 + seconds
            session.add(
                Job(stage=stage, position=0, queue="q", state=state, created_at=1.0, started_at=100.0, finished_at=finished)
            )


def test_usual_seconds_are_means_over_the_newest_finished_jobs_of_each_stage(database: Database) -> None:
    add(database, "odometry", "done", 1000.0, 5)
    add(database, "odometry", "done", 10.0)
    add(database, "odometry", "done", 30.0)
    add(database, "labelling", "done", 7.0)
    add(database, "odometry", "failed", 5.0)
    add(database, "segmentation", "running", None)
    with database.write() as session:
        assert usual_seconds(session, newest_jobs=3) == pytest.approx({"odometry": 20.0, "labelling": 7.0})
        assert usual_seconds(session) == pytest.approx({"odometry": 5040.0 / 7, "labelling": 7.0})
