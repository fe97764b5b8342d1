"""Hooks of the service around the stages: a drive's run by the pipeline's catalogue, the map's by stitching and tiles."""

import hashlib
import json
from dataclasses import replace
from typing import Any, Final

import numpy as np

from wayloom.config.gate import gate_of
from wayloom.config.stages import INGEST, ODOMETRY, REMOVAL
from wayloom.geodesy import wgs84
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality
from wayloom.pipeline.log_parts import LOG_FILE
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import part_room, run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings, with_asked
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages.submaps import PREVIEW_FILE
from wayloom.reports.drive_warnings import CALIBRATION_FACTS, NETWORK_FACTS
from wayloom.segmentation.keyframe_labels import MODEL_FILE
from wayloom.store import drives, reprocessing, runs
from wayloom.store.coming import note, note_place
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.submaps.files import StoredSubmaps
from wayloom_workers.drive_sightings import OBJECTS
from wayloom_workers.exclusion import exclude
from wayloom_workers.finished_stages import finished_stages
from wayloom_workers.map_reach import check_reach
from wayloom_workers.publishing import publish, request_publish, tidy
from wayloom_workers.removal import nothing, remove_files, remove_rows
from wayloom_workers.rig_memory import forget, remember, remember_gnss, rig_file_for
from wayloom_workers.stage_hooks import PreparedStage, Record, StageAttempt, StageHooks, StageParts, at_once, keyed_by_inputs
from wayloom_workers.submap_rows import submap_row

TRACK_POINTS: Final = 2000
GEOREFERENCE: Final = "georeference"
SUBMAPS: Final = "submaps"


def _settings(attempt: StageAttempt) -> ProcessSettings:
    """Those of the service that a drive's stages are told, and above them those that were asked for when it is processed anew.
    Persons are never kept."""
    with attempt.context.database.read() as session:
        asked = (drives.get(session, str(attempt.claim.drive_id)).coming or {}).get("asked", {})
    return with_asked(
        attempt.context.settings.of_drives(), {**asked, "submaps": {**asked.get("submaps", {}), "keep_persons": False}}
    )


def _prepare(attempt: StageAttempt) -> PreparedStage:
    """The stage of the catalogue, on the drive's log, which is opened once."""
    assert attempt.log_path is not None
    source = LogSource(attempt.log_path, attempt.gnss_path)
    stage, settings = attempt.claim.stage, _settings(attempt)
    if stage == INGEST:
        check_reach(source.log.gnss, attempt.context.settings)
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


def _record_log(attempt: StageAttempt) -> Record:
    """What the log is, for the drive's page."""
    content = json.loads((attempt.out_dir / LOG_FILE).read_text(encoding="utf-8"))
    facts = _finite({name: content["log"][name] for name in content["log"].keys() - {"path", "name"}})

    def write(session: Session) -> list[JobMessage]:
        note(drives.get(session, str(attempt.claim.drive_id)), log=facts)
        return []

    return write


def _record_tracking(attempt: StageAttempt) -> Record:
    """How much of the drive was tracked, and how far its calibration is off, for its warnings."""
    odometry = load_odometry(attempt.out_dir / ODOMETRY_FILE)
    tracked, segment = odometry.trajectory.tracked, odometry.trajectory.segment
    losses = [{"frame": one["frame"], "reason": one["reason"]} for one in odometry.report.get("losses", ())]
    counted = {"frames": len(tracked), "frames_tracked": int(tracked.sum()), "segments": len(np.unique(segment))}
    calibration: dict[str, Any] = {name: odometry.report[name] for name in CALIBRATION_FACTS if name in odometry.report}
    facts = _finite({**counted, **calibration, "losses": losses[:20]})

    def write(session: Session) -> list[JobMessage]:
        note(drives.get(session, str(attempt.claim.drive_id)), odometry=facts)
        return []

    return write


def _record_network(attempt: StageAttempt) -> Record:
    """Which network labelled the drive, for its warnings."""
    content = json.loads((attempt.out_dir / MODEL_FILE).read_text(encoding="utf-8"))
    facts = _finite({name: content[name] for name in NETWORK_FACTS if name in content})

    def write(session: Session) -> list[JobMessage]:
        note(drives.get(session, str(attempt.claim.drive_id)), network=facts)
        return []

    return write


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


def _record_track(attempt: StageAttempt) -> Record:
    """Where the drive went, thinned for the page, and what the geo-reference says of itself."""
    geo = load_georeference(attempt.out_dir / GEOREFERENCE_FILE)
    track = None
    if geo.frame is not None:
        rows = np.unique(np.linspace(0, len(geo.T_enu_cam) - 1, TRACK_POINTS).round().astype(int))
        lon_lat_height = wgs84.lonlatheight_from_enu(geo.T_enu_cam[rows, :3, 3], geo.frame)
        track = np.column_stack([lon_lat_height[:, :2].round(9), lon_lat_height[:, 2].round(4)]).tolist()
    quality = read_quality(attempt.out_dir / QUALITY_FILE)
    sound = bool(quality.get("sound"))
    verdict = gate_of(quality["grade"], attempt.context.settings.gate, sound)
    facts = {"georeference": _finite(geo.report), "quality": hashlib.sha256(_quality(attempt)).hexdigest()}

    def write(session: Session) -> list[JobMessage]:
        drive = drives.get(session, str(attempt.claim.drive_id))
        note_place(drive, geo.frame is not None, track)
        reprocessing.judge(session, drive.id, quality["grade"], quality["reasons"], verdict, sound)
        note(drive, **facts)
        return []

    return write


def _share_quality(attempt: StageAttempt) -> None:
    attempt.context.blobs.put(_quality(attempt))


def _quality(attempt: StageAttempt) -> bytes:
    """The quality report with its pictures: one blob, so that the API needs nothing of the drive's folder."""
    from wayloom.reports.quality_plots import quality_pictures  # matplotlib is loaded when the first drive is placed

    quality = read_quality(attempt.out_dir / QUALITY_FILE)
    return json.dumps({**quality, "pictures": quality_pictures(quality)}, separators=(",", ":")).encode()


def _finite(facts: dict[str, Any]) -> dict[str, Any]:
    """The facts with None for what is no number: JSON has no NaN, and neither have databases and browsers."""
    found: dict[str, Any] = json.loads(json.dumps(facts), parse_constant=lambda _: None)
    return found


def _prepare_stitch(attempt: StageAttempt) -> PreparedStage:
    """The map's stage, after what lies in excluded areas was dropped from what it is made of."""
    from wayloom_workers.stitching import prepare_stitch  # what makes maps of fleets is loaded by those who make one

    if not attempt.claim.part:
        exclude(attempt.context, str(attempt.claim.map_id))
    return prepare_stitch(attempt)


def _share_submaps(attempt: StageAttempt) -> None:
    """The submaps' blobs, after the drive's last stage: nothing names them before, and they would be dropped as unused."""
    for placed in StoredSubmaps(attempt.inputs_dir / SUBMAPS):
        attempt.context.blobs.put(placed.submap.encoded)
    attempt.context.blobs.put(_preview(attempt))


def _preview(attempt: StageAttempt) -> bytes:
    """The picture of the drive from above that the stage of the submaps left."""
    return (attempt.inputs_dir / SUBMAPS / PREVIEW_FILE).read_bytes()


def _record_submaps(attempt: StageAttempt) -> Record:
    """Place the submaps, now that all that the map takes of them is there; those without a place on Earth wait for other drives to
    give them one."""
    drive_id, items = str(attempt.claim.drive_id), StoredSubmaps(attempt.inputs_dir / SUBMAPS)
    with attempt.context.database.read() as session:
        map_id = drives.get(session, drive_id).map_id
    rows = [submap_row(drive_id, map_id, position, item) for position, item in enumerate(items)]
    preview = hashlib.sha256(_preview(attempt)).hexdigest()

    def write(session: Session) -> list[JobMessage]:
        drive = drives.get(session, drive_id)
        reprocessing.place_submaps(session, drive_id, rows)
        runs.record(session, drive, finished_stages(session, attempt), [row.digest for row in rows])
        note(drive, preview=preview)
        return []

    return write


_HOOKS: Final = {
    INGEST: StageHooks(_prepare, record=_record_log),
    ODOMETRY: StageHooks(_prepare, share=_remember_rig, record=_record_tracking),
    "segmentation": StageHooks(_prepare, record=_record_network),
    "georeference": StageHooks(_prepare, share=_share_georeference, record=_record_track),
    OBJECTS: StageHooks(_prepare, share=_share_submaps, record=_record_submaps),
    "stitch": StageHooks(_prepare_stitch, record=at_once(request_publish)),
    "publish": StageHooks(keyed_by_inputs(tidy), record=at_once(publish)),
    REMOVAL.name: StageHooks(keyed_by_inputs(nothing), share=_remove, record=at_once(remove_rows)),
}


def stage_hooks(stage: str) -> StageHooks:
    """What a worker does around a stage: for a drive's stage that needs nothing special, the catalogue's run and no more."""
    return _HOOKS.get(stage) or StageHooks(_prepare)
