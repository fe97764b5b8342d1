"""Times to go that were told of a drive, judged as its last stage ends it."""

from pathlib import Path

from sqlalchemy import select

from wayloom.store import drives, jobs
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom.store.tables.drives import DriveEstimate
from wayloom_workers.completion import complete_drive


def test_a_drive_that_ends_outside_of_the_map_has_its_estimates_judged(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
    upgrade(database)
    with database.write() as session:
        manifest = Manifest(name="a", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive, _ = drives.register(session, manifest, "city")
        message = drives.mark_complete(session, drive.id, "log/a")
        assert message is not None
    assert jobs.claim(database, message.job_id, "elsewhere|1|1", 60.0) is not None
    with database.write() as session:
        complete_drive(session, drive.id)
        (row,) = session.scalars(select(DriveEstimate))
        assert row.truth_s is not None
        assert row.truth_s >= 0.0
    database.close()
