"""Publish stage of the map: the tiles that were stitched become the next version."""

import json
import shutil
from collections.abc import Iterator
from typing import Final

import structlog

from wayloom.store import drives, excluded, jobs, map_versions, meetings, reprocessing
from wayloom.store.blobs import BlobError
from wayloom.store.database import DatabaseError, Session
from wayloom.store.folders import Folders
from wayloom.store.garbage import drop_unused
from wayloom.store.jobs import JobMessage
from wayloom.store.map_versions import REGION_FEATURES, MovedSubmap, NewVersion, RegionEntry, TileEntry
from wayloom.store.spatial.shown_features import show
from wayloom.store.tables.drives import Job
from wayloom_workers.stage_hooks import StageAttempt

log = structlog.get_logger()
TILES_FILE: Final = "tiles.json"


def request_publish(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """What was stitched is published next; nothing else is done to the map before."""
    payload = {"stitch": attempt.out_dir.name}
    job = jobs.create_map_job(session, "publish", str(attempt.claim.map_id), payload, attempt.claim.job_id)
    return [JobMessage(job.id, job.queue)]


def tidy(attempt: StageAttempt) -> None:
    """Before publishing: drop the lists of tiles of earlier versions, the folders of removed drives that a stage was still writing
    to, and the blobs that nothing names any more."""
    stages = attempt.context.folders.map(str(attempt.claim.map_id)) / "stages"
    for stage in stages.iterdir():
        for output in stage.iterdir():
            if output.name not in attempt.inputs.values():
                shutil.rmtree(output, ignore_errors=True)
    shutil.rmtree(stages.parent / "parts", ignore_errors=True)  # of stitches that were given up
    _drop_folders(attempt)
    try:
        dropped = drop_unused(attempt.context.database, attempt.context.blobs, lambda: listed_tiles(attempt.context.folders))
        log.info("blobs dropped", count=dropped)
    except (BlobError, DatabaseError, OSError) as error:  # the map does not wait for it: the next version drops them
        log.warning("blobs were not dropped", error=str(error))


def _drop_folders(attempt: StageAttempt) -> None:
    """Folders first, rows second: a drive has its row before its folder."""
    found = [*attempt.context.folders.all_drives.glob("*")]
    with attempt.context.database.read() as session:
        known = drives.all_ids(session)
    for folder in found:
        if folder.name not in known:
            shutil.rmtree(folder, ignore_errors=True)


def listed_tiles(folders: Folders) -> Iterator[str]:
    """The digests in every list of tiles and regions that is published, or may be yet."""
    for path in folders.all_maps.glob(f"*/stages/stitch/*/{TILES_FILE}"):
        listed = json.loads(path.read_text(encoding="utf-8"))
        yield from (entry["digest"] for entry in [*listed["tiles"], *listed["regions"]])
        yield from (entry[of] for of in ("ground", *REGION_FEATURES) for entry in listed["regions"] if entry.get(of))


def publish(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """The next version, and the flip of the map's pointer to it."""
    stitched = json.loads((attempt.inputs_dir / "stitch" / TILES_FILE).read_text(encoding="utf-8"))
    new = NewVersion(
        base=stitched["base"],
        frame=tuple(stitched["frame"]),
        drives=tuple(stitched["drives"]),
        submap_count=stitched["submaps"],
        bounds=None if stitched["bounds"] is None else tuple(stitched["bounds"]),
        tiles=[TileEntry(**entry) for entry in stitched["tiles"]],
        dropped_tiles=[(layer, z, x, y) for layer, z, x, y in stitched["dropped_tiles"]],
        regions=[RegionEntry(**entry) for entry in stitched["regions"]],
        dropped_regions=[(east, north) for east, north in stitched["dropped_regions"]],
        moved=[MovedSubmap.from_json(one) for one in stitched["moved"]],
        verdicts=stitched.get("verdicts", {}),
        taken_in=stitched["taken_in"],
        facts=stitched["facts"] | ({"out_of_reach": stitched["out_of_reach"]} if stitched["out_of_reach"] else {}),
        built_with=stitched["built_with"],
        out_of_reach=tuple(stitched["out_of_reach"]),
    )
    changed = map_versions.changed_drives(session, str(attempt.claim.map_id))
    job = session.get(Job, attempt.claim.job_id)
    stitch_job_id = None if job is None else job.parent_id
    map_versions.publish(session, str(attempt.claim.map_id), new, attempt.context.settings.map_versions_kept, stitch_job_id)
    show(session, attempt.context.blobs, str(attempt.claim.map_id))
    meetings.forget_gone(session, str(attempt.claim.map_id), changed)
    if stitch_job_id is not None:
        reprocessing.take_published(session, str(attempt.claim.map_id), stitch_job_id)
        excluded.published(session, str(attempt.claim.map_id), stitch_job_id)
    return []
