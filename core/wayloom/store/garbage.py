"""Garbage collection of blobs that nothing names any more: tiles of forgotten versions, submaps and pictures of removed drives.

A blob is named by rows or, between stitching and publishing, by a map's list of tiles. A running job may have stored a blob, or
found it stored, that it has not named yet. So blobs are looked through only while no job that stores any is running, and deleted
only as long as none was claimed since; claims wait for each batch.
"""

from collections.abc import Callable, Iterable
from typing import Final

from sqlalchemy import select, text

from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.tables import Drive, Job, RegionRow, RigEvidence, RigVersion, SubmapRow, TileRow

STORING: Final = ("odometry", "georeference", "submaps", "stitch", "remove")
"""The stages that store blobs."""
NAMED: Final = (TileRow.digest, RegionRow.digest, SubmapRow.digest, RigEvidence.digest, RigEvidence.own_digest, RigVersion.digest)
"""Columns that name blobs."""
GRACE_S: Final = 3600.0
BATCH: Final = 100


def drop_unused(database: Database, blobs: BlobStore, listed: Callable[[], Iterable[str]], grace_s: float = GRACE_S) -> int:
    """Delete the blobs older than `grace_s` that neither a row nor `listed()` names. Returns how many; 0 while blobs are stored."""
    with database.read() as session:
        claims = _claims(session)
    if claims is None:
        return 0
    unused = set(blobs.older_than(grace_s))
    unused.difference_update(listed())
    with database.read() as session:
        named_of_drives = (Drive.facts[name].as_string() for name in ("preview", "quality"))
        for named in (*NAMED, *named_of_drives):
            unused.difference_update(session.scalars(select(named).distinct().execution_options(yield_per=10_000)))
    found = sorted(unused)
    for start in range(0, len(found), BATCH):
        if not _delete(database, blobs, found[start : start + BATCH], claims):
            return start
    return len(found)


def _delete(database: Database, blobs: BlobStore, digests: list[str], claims: frozenset[tuple[int, int]]) -> bool:
    """Delete while no job can be claimed. False, and nothing is deleted, when one was."""
    with database.write() as session:
        if database.dialect == "postgresql":  # SQLite has one writer anyway
            session.execute(text("LOCK TABLE jobs IN SHARE ROW EXCLUSIVE MODE"))
        if _claims(session) != claims:
            return False
        for digest in digests:
            blobs.delete(digest)
    return True


def _claims(session: Session) -> frozenset[tuple[int, int]] | None:
    """(job, token) of every claim so far of a job that stores blobs; None while one runs."""
    rows = session.execute(select(Job.id, Job.token, Job.state).where(Job.stage.in_(STORING), Job.token > 0)).all()
    return None if any(state == "running" for _, _, state in rows) else frozenset((job_id, token) for job_id, token, _ in rows)
