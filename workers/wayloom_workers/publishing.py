"""The map's last stage: the tiles that were stitched become the next version."""

import json
import shutil
from typing import Final

from wayloom.store import jobs, maps
from wayloom.store.database import Session
from wayloom.store.jobs import Wake
from wayloom.store.maps import NewVersion, TileEntry
from wayloom_workers.steps import Work

TILES_FILE: Final = "tiles.json"


def request_publish(session: Session, work: Work) -> list[Wake]:
    """What was stitched is published next; nothing else is done to the map before."""
    payload = {"stitch": work.out_dir.name}
    job = jobs.create_map_job(session, "publish", str(work.claim.map_id), payload, work.claim.job_id)
    return [Wake(job.id, job.queue)]


def tidy(work: Work) -> None:
    """Before publishing: drop the lists of tiles of earlier versions."""
    stages = work.bench.folders.map(str(work.claim.map_id)) / "stages"
    for stage in stages.iterdir():
        for output in stage.iterdir():
            if output.name not in work.inputs.values():
                shutil.rmtree(output, ignore_errors=True)


def publish(session: Session, work: Work) -> list[Wake]:
    """The next version, and the flip of the map's pointer to it."""
    said = json.loads((work.inputs_dir / "stitch" / TILES_FILE).read_text(encoding="utf-8"))
    new = NewVersion(
        frame=tuple(said["frame"]),
        drives=tuple(said["drives"]),
        submap_count=said["submaps"],
        bounds=None if said["bounds"] is None else tuple(said["bounds"]),
        tiles=[TileEntry(**entry) for entry in said["tiles"]],
        facts={"out_of_reach": said["out_of_reach"]} if said["out_of_reach"] else {},
        out_of_reach=tuple(said["out_of_reach"]),
    )
    maps.publish(session, str(work.claim.map_id), new, work.bench.settings.map_versions_kept)
    return []
