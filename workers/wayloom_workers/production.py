"""Hooks of the service around the stages: a drive's run by the pipeline's catalogue, the map's by stitching and tiles."""

import hashlib
import json
from dataclasses import replace
from typing import Any, Final

import numpy as np

from wayloom.config.gate import gate_of
from wayloom.config.stages import REMOVAL
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality
from wayloom.pipeline.log_parts import LOG_FILE
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import part_room, run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages.submaps import PREVIEW_FILE
from wayloom.reports.quality_plots import quality_pictures
from wayloom.store import drives, gate, maps
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.tables import SubmapRow
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.publishing import publish, request_publish, tidy
from wayloom_workers.removal import nothing, remove_files, remove_rows
from wayloom_workers.rig_memory import forget, remember, remember_gnss, rig_file_for
from wayloom_workers.stage_hooks import PreparedStage, StageAttempt, StageHooks, StageParts, keyed_by_inputs
from wayloom_workers.stitching import prepare_stitch

TRACK_POINTS: Final = 2000
ODOMETRY: Final = "odometry"
GEOREFERENCE: Final = "georeference"


def _settings(attempt: StageAttempt) -> ProcessSettings:
    """Those of the service that a drive's stages are told."""
    return attempt.context.settings.of_drives()


def _prepare(attempt: StageAttempt) -> PreparedStage:
    """The stage of the catalogue, on the drive's log, which is opened once."""
    assert attempt.log_path is not None
    source = LogSource(attempt.log_path, attempt.gnss_path)
    stage, settings = attempt.claim.stage, _settings(attempt)
    if stage in (ODOMETRY, GEOREFERENCE):
        settings = settings.model_copy(update={"rig": rig_file_for(attempt, source.log)})
    context = StageContext(source, attempt.inputs_dir, settings, attempt.claim.drive_id)
    key = stage_key(stage, context)
    context = replace(context, parts_dir=attempt.context.folders.drive(str(attempt.claim.drive_id)) / "parts" / stage / key.hex)

    def run() -> None:
        run_stage(stage, context, attempt.out_dir, attempt.progress, key)

    return PreparedStage(key.hex, run, _parts(attempt, context))


def _parts(attempt: StageAttempt, context: StageContext) -> StageParts | None:
    """The parts of a stage whose room makes it in parts. (Rows number them from 1, rooms from 0.)"""
    room, folder = part_room(attempt.claim.stage), context.parts_dir
    if room is None or folder is None:
        return None
    return StageParts(
        folder.parent,
        lambda: [number + 1 for number in room.missing(context, folder, attempt.progress)],
        lambda part: room.has(folder, part - 1),
        lambda part: room.make(context, part - 1, attempt.out_dir, attempt.progress),
        lambda part: folder / room.name(part - 1),
    )


def _record_log(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """What the log is, for the drive's page."""
    content = json.loads((attempt.out_dir / LOG_FILE).read_text(encoding="utf-8"))
    drive = drives.get(session, str(attempt.claim.drive_id))
    drive.facts = {**drive.facts, "log": _finite({name: content["log"][name] for name in content["log"].keys() - {"path", "name"}})}
    return []


def _remember_rig(attempt: StageAttempt) -> None:
    """What the drive says of its rig becomes the rig's."""
    assert attempt.log_path is not None
    remember(attempt, LogSource(attempt.log_path, attempt.gnss_path).log)


def _share_georeference(attempt: StageAttempt) -> None:
    """The pictures of the drive's quality, and what GNSS says of the rig."""
    _share_quality(attempt)
    remember_gnss(attempt)


def _remove(attempt: StageAttempt) -> None:
    """The rig forgets the drive, and its files go."""
    forget(attempt)
    remove_files(attempt)


def _record_track(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """Where the drive went, thinned for the page, and what the geo-reference says of itself."""
    geo = load_georeference(attempt.out_dir / GEOREFERENCE_FILE)
    drive = drives.get(session, str(attempt.claim.drive_id))
    drive.placed = geo.frame is not None
    drive.facts = {**drive.facts, "georeference": _finite(geo.report)}
    if geo.frame is not None:
        rows = np.unique(np.linspace(0, len(geo.T_enu_cam) - 1, TRACK_POINTS).round().astype(int))
        lon_lat_height = wgs84.lonlatheight_from_enu(geo.T_enu_cam[rows, :3, 3], geo.frame)
        drive.track = np.column_stack([lon_lat_height[:, :2].round(9), lon_lat_height[:, 2].round(4)]).tolist()
    quality = read_quality(attempt.out_dir / QUALITY_FILE)
    verdict = gate_of(quality["grade"], attempt.context.settings.gate)
    gate.judge(session, drive.id, quality["grade"], quality["reasons"], verdict)
    drive.facts = {**drive.facts, "quality": hashlib.sha256(_quality(attempt)).hexdigest()}
    return []


def _share_quality(attempt: StageAttempt) -> None:
    attempt.context.blobs.put(_quality(attempt))


def _quality(attempt: StageAttempt) -> bytes:
    """The quality report with its pictures: one blob, so that the API needs nothing of the drive's folder."""
    quality = read_quality(attempt.out_dir / QUALITY_FILE)
    return json.dumps({**quality, "pictures": quality_pictures(quality)}, separators=(",", ":")).encode()


def _finite(facts: dict[str, Any]) -> dict[str, Any]:
    """The facts with None for what is no number: JSON has no NaN, and neither have databases and browsers."""
    found: dict[str, Any] = json.loads(json.dumps(facts), parse_constant=lambda _: None)
    return found


def _share_submaps(attempt: StageAttempt) -> None:
    for placed in load_submaps(attempt.out_dir):
        attempt.context.blobs.put(placed.submap.encoded)
    attempt.context.blobs.put(_preview(attempt))


def _preview(attempt: StageAttempt) -> bytes:
    """The picture of the drive from above that the stage left."""
    return (attempt.out_dir / PREVIEW_FILE).read_bytes()


def _record_submaps(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """Place the submaps; those without a place on Earth stay outside of the map."""
    drive = drives.get(session, str(attempt.claim.drive_id))
    placed = [item for item in load_submaps(attempt.out_dir) if item.frame is not None]
    rows = [submap_row(drive.id, drive.map_id, position, item) for position, item in enumerate(placed)]
    maps.place_submaps(session, drive.id, rows)
    drive.facts = {**drive.facts, "preview": hashlib.sha256(_preview(attempt)).hexdigest()}
    return []


def submap_row(drive_id: str, map_id: str, position: int, placed: PlacedSubmap) -> SubmapRow:
    """The row of a submap that has a place on Earth."""
    assert placed.frame is not None
    covariance = np.where(np.isfinite(placed.covariance), placed.covariance, 0.0)
    track = wgs84.lonlatheight_from_enu(placed.track_enu(), placed.frame)[:, :2]
    points = wgs84.lonlatheight_from_enu(placed.points_enu(), placed.frame)[:, :2]
    west, south, east, north = box_of(np.vstack([track, points]))
    return SubmapRow(
        drive_id=drive_id, map_id=map_id, position=position, digest=placed.submap.digest, point_count=len(placed.submap),
        frame=[placed.frame.lon_deg, placed.frame.lat_deg, placed.frame.height_m], T_enu_submap=placed.T_enu_submap.tolist(),
        covariance=covariance.tolist(), track=track.tolist(), track_t_ns=int(placed.submap.keyframe_t_ns.min(initial=2**62)),
        min_lon=west, min_lat=south, max_lon=east, max_lat=north,
    )  # fmt: skip


_HOOKS: Final = {
    "ingest": StageHooks(_prepare, record=_record_log),
    ODOMETRY: StageHooks(_prepare, share=_remember_rig),
    "georeference": StageHooks(_prepare, share=_share_georeference, record=_record_track),
    "submaps": StageHooks(_prepare, share=_share_submaps, record=_record_submaps),
    "stitch": StageHooks(prepare_stitch, record=request_publish),
    "publish": StageHooks(keyed_by_inputs(tidy), record=publish),
    REMOVAL.name: StageHooks(keyed_by_inputs(nothing), share=_remove, record=remove_rows),
}


def stage_hooks(stage: str) -> StageHooks:
    """What a worker does around a stage: for a drive's stage that needs nothing special, the catalogue's run and no more."""
    return _HOOKS.get(stage) or StageHooks(_prepare)
