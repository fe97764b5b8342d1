"""The stages as the service runs them: those of a drive by `wayloom.pipeline`, those of the map by stitching and tiles."""

import hashlib
import json
from typing import Any, Final

import numpy as np

from wayloom.geodesy import wgs84
from wayloom.georeference.files import load_georeference
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stages import GEOREFERENCE_FILE, PREVIEW_FILE, run_stage, stage_key
from wayloom.store import drives, jobs, maps
from wayloom.store.database import Session, now_s
from wayloom.store.jobs import JobMessage
from wayloom.store.queues import REMOVE
from wayloom.store.tables import SubmapRow
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.publishing import publish, request_publish, tidy
from wayloom_workers.removal import nothing, remove_files, remove_rows
from wayloom_workers.steps import StageAttempt, Step, Steps
from wayloom_workers.stitching import stitch

TRACK_POINTS: Final = 2000


def _settings(work: StageAttempt) -> ProcessSettings:
    """Those of the service that a drive's stages are told."""
    return work.bench.settings.of_drives()


def _call(work: StageAttempt) -> dict[str, Any]:
    return {
        "log_path": work.log_path,
        "gnss_path": work.gnss_path,
        "inputs_dir": work.inputs_dir,
        "settings": _settings(work),
        "drive_id": work.claim.drive_id,
    }


def _run(work: StageAttempt) -> None:
    run_stage(work.claim.stage, out_dir=work.out_dir, progress=work.progress, **_call(work))


def _key(work: StageAttempt) -> str:
    return stage_key(work.claim.stage, **_call(work))


def _record_log(session: Session, work: StageAttempt) -> list[JobMessage]:
    """What the log is, for the drive's page."""
    said = json.loads((work.out_dir / "log.json").read_text(encoding="utf-8"))
    drive = drives.get(session, str(work.claim.drive_id))
    drive.facts = {**drive.facts, "log": _finite({name: said["log"][name] for name in said["log"].keys() - {"path", "name"}})}
    return []


def _record_track(session: Session, work: StageAttempt) -> list[JobMessage]:
    """Where the drive went, thinned for the page, and what the geo-reference says of itself."""
    geo = load_georeference(work.out_dir / GEOREFERENCE_FILE)
    drive = drives.get(session, str(work.claim.drive_id))
    drive.placed = geo.frame is not None
    drive.facts = {**drive.facts, "georeference": _finite(geo.report)}
    if geo.frame is not None:
        rows = np.unique(np.linspace(0, len(geo.T_enu_cam) - 1, TRACK_POINTS).round().astype(int))
        lon_lat_height = wgs84.lonlatheight_from_enu(geo.T_enu_cam[rows, :3, 3], geo.frame)
        drive.track = np.column_stack([lon_lat_height[:, :2].round(7), lon_lat_height[:, 2].round(2)]).tolist()
    return []


def _finite(facts: dict[str, Any]) -> dict[str, Any]:
    """The facts with None for what is no number: JSON has no NaN, and neither have databases and browsers."""
    found: dict[str, Any] = json.loads(json.dumps(facts), parse_constant=lambda _: None)
    return found


def _share_submaps(work: StageAttempt) -> None:
    for placed in load_submaps(work.out_dir):
        work.bench.blobs.put(placed.submap.encoded)
    work.bench.blobs.put(_preview(work))


def _preview(work: StageAttempt) -> bytes:
    """The picture of the drive from above that the stage left."""
    return (work.out_dir / PREVIEW_FILE).read_bytes()


def _record_submaps(session: Session, work: StageAttempt) -> list[JobMessage]:
    """Place the submaps and have the map stitched; a drive without a place ends here."""
    drive = drives.get(session, str(work.claim.drive_id))
    placed = [item for item in load_submaps(work.out_dir) if item.frame is not None]
    rows = [submap_row(drive.id, drive.map_id, position, item) for position, item in enumerate(placed)]
    maps.place_submaps(session, drive.id, rows)
    drive.facts = {**drive.facts, "preview": hashlib.sha256(_preview(work)).hexdigest()}
    if not rows:
        drive.state, drive.finished_at = "done", now_s(session)
        return []
    job = jobs.request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id = "stitching", job.id
    return [JobMessage(job.id, job.queue)]


def submap_row(drive_id: str, map_id: str, position: int, placed: PlacedSubmap) -> SubmapRow:
    """The row of a submap that has a place on Earth."""
    assert placed.frame is not None
    covariance = np.where(np.isfinite(placed.covariance), placed.covariance, 0.0)
    corners = placed.points_enu() if len(placed.submap) else placed.track_enu()
    lon_lat = wgs84.lonlatheight_from_enu(corners, placed.frame)[:, :2]
    (west, south), (east, north) = lon_lat.min(axis=0).tolist(), lon_lat.max(axis=0).tolist()
    return SubmapRow(
        drive_id=drive_id, map_id=map_id, position=position, digest=placed.submap.digest, point_count=len(placed.submap),
        frame=[placed.frame.lon_deg, placed.frame.lat_deg, placed.frame.height_m], T_enu_submap=placed.T_enu_submap.tolist(),
        covariance=covariance.tolist(), min_lon=west, min_lat=south, max_lon=east, max_lat=north,
    )  # fmt: skip


STEPS: Final[Steps] = {
    "ingest": Step(_run, key=_key, record=_record_log),
    "odometry": Step(_run, key=_key),
    "segmentation": Step(_run, key=_key),
    "labelling": Step(_run, key=_key),
    "georeference": Step(_run, key=_key, record=_record_track),
    "submaps": Step(_run, key=_key, share=_share_submaps, record=_record_submaps),
    "stitch": Step(stitch, record=request_publish),
    "publish": Step(tidy, record=publish),
    REMOVE: Step(nothing, share=remove_files, record=remove_rows),
}
