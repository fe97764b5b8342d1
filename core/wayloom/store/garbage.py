"""Garbage collection of blobs that nothing names any more: tiles of forgotten versions, submaps and pictures of removed drives.

A blob is named by rows or, between stitching and publishing, by a map's list of tiles. A running job may have stored a blob, or
found it stored, that it has not named yet. So blobs are looked through only while no job that stores any is running, and deleted
only as long as none was claimed since; claims wait for each batch.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Final

from sqlalchemy import delete, select, text

from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database, Session
from wayloom.store.tables.drives import Drive, Job, SubmapRow
from wayloom.store.tables.maps import ForgottenBlob, MeetingRow, RegionRow, TileRow
from wayloom.store.tables.rigs import RigEvidence, RigVersion

STORING: Final = ("odometry", "georeference", "objects", "stitch", "remove")
"""The stages that store blobs."""
NAMED: Final = (
    TileRow.digest, RegionRow.digest, RegionRow.ground, RegionRow.markings, RegionRow.areas, RegionRow.objects, MeetingRow.digest,
    SubmapRow.digest, RigEvidence.digest, RigEvidence.own_digest, RigVersion.digest,
    *(facts[name].as_string() for facts in (Drive.facts, Drive.coming["facts"]) for name in ("preview", "quality")),
)  # fmt: skip
"""Columns that name blobs, and places in columns."""
GRACE_S: Final = 3600.0
BATCH: Final = 100


def drop_unused(database: Database, blobs: BlobStore, listed: Callable[[], Iterable[str]], grace_s: float = GRACE_S) -> int:
    """Delete the blobs older than `grace_s` that neither a row nor `listed()` names. Returns how many; 0 while blobs are stored."""
    with database.read() as session:
        claims = _claims(session, STORING)
    if claims is None:
        return 0
    unused = set(blobs.older_than(grace_s))
    unused.difference_update(listed())
    with database.read() as session:
        for named in NAMED:
            unused.difference_update(session.scalars(select(named).distinct().execution_options(yield_per=10_000)))
    found = sorted(unused)
    for start in range(0, len(found), BATCH):
        if not _delete(database, blobs, found[start : start + BATCH], STORING, claims):
            return start
    return len(found)


def drop_forgotten(database: Database, blobs: BlobStore, listed: Callable[[], Iterable[str]]) -> int:
    """Delete what held a removed drive and nothing names any more, however young. What a job of its stage may be about to name
    waits until none runs, what `listed()` names for its version. Returns how many were deleted."""
    with database.read() as session:
        rows = session.execute(select(ForgottenBlob.stage, ForgottenBlob.digest).order_by(ForgottenBlob.digest)).all()
    if not rows:
        return 0
    awaited, count = set(listed()), 0
    for stage in sorted({stage for stage, _ in rows}):
        count += _drop_forgotten(database, blobs, stage, [digest for of, digest in rows if of == stage and digest not in awaited])
    return count


def _drop_forgotten(database: Database, blobs: BlobStore, stage: str, digests: Sequence[str]) -> int:
    with database.read() as session:
        claims = _claims(session, (stage,))
    count = 0
    for start in range(0, len(digests), BATCH) if claims is not None else ():
        some = digests[start : start + BATCH]
        with database.read() as session:
            named = {digest for column in NAMED for digest in session.scalars(select(column).where(column.in_(some)))}
        unused = [digest for digest in some if digest not in named]
        if claims is None or not _delete(database, blobs, unused, (stage,), claims):
            return count
        with database.write() as session:
            session.execute(delete(ForgottenBlob).where(ForgottenBlob.digest.in_(some)))
        count += len(unused)
    return count


def _delete(
    database: Database, blobs: BlobStore, digests: Sequence[str], stages: Sequence[str], claims: frozenset[tuple[int, int]]
) -> bool:
    """Delete while no job can be claimed. False, and nothing is deleted, when one of the stages was."""
    with database.write() as session:
        if database.dialect == "postgresql":  # SQLite has one writer anyway
            session.execute(text("LOCK TABLE jobs IN SHARE ROW EXCLUSIVE MODE"))
        if _claims(session, stages) != claims:
            return False
        for digest in digests:
            blobs.delete(digest)
    return True


def _claims(session: Session, stages: Sequence[str]) -> frozenset[tuple[int, int]] | None:
    """(job, token) of every claim so far of a job of these stages; None while one runs."""
    rows = session.execute(select(Job.id, Job.token, Job.state).where(Job.stage.in_(stages), Job.token > 0)).all()
    return None if any(state == "running" for _, _, state in rows) else frozenset((job_id, token) for job_id, token, _ in rows)
