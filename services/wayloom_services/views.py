"""Conversion of database rows to response models."""

import math
import time
from collections.abc import Mapping, Sequence

from wayloom.config.stages import drive_stages, map_stages
from wayloom.pipeline.digests import sha256_of_json
from wayloom.reports.drive_warnings import noted_warnings
from wayloom.store import drives, maps
from wayloom.store.coming import shown_verdict
from wayloom.store.database import Session
from wayloom.store.drives import Received
from wayloom.store.etas.intervals import Learnt
from wayloom.store.gate import STATE_OUTSIDE, passes
from wayloom.store.tables.drives import Drive, DriveRun, Job, SubmapRow
from wayloom.store.tables.maps import MapVersion
from wayloom_services.etas import NOTHING_LEARNT, Past, etas_of
from wayloom_services.schemas.drives import DriveOut, LossOut, MapVerdictOut, QualityOut, ReleaseOut, ReprocessOut, StageOut
from wayloom_services.schemas.lineage import MadeBy, NetworkOut, RunDetail, RunOut
from wayloom_services.schemas.maps import SubmapOut, VersionOut
from wayloom_services.schemas.privacy import ImagesOut


def drives_out(session: Session, rows: Sequence[Drive], past: Past) -> list[DriveOut]:
    """The drives with their stages. past : what their remaining time is told by"""
    jobs = drives.jobs_of(session, rows)
    received = drives.received(session, rows)
    at_work = any(row.coming is not None or row.state in ("queued", "running", "stitching") for row in rows)
    usual = past.usual(session) if at_work else {}
    learnt = past.learnt(session) if at_work else NOTHING_LEARNT
    return [drive_out(row, jobs[row.id], received[row.id], usual, learnt) for row in rows]


def drive_out(
    drive: Drive, jobs: Sequence[Job], received: Received, usual: Mapping[str, float], learnt: Learnt = NOTHING_LEARNT
) -> DriveOut:
    """Response model of a drive. usual : duration of each stage, s. learnt : factors of the intervals of its remaining time"""
    now = time.time()
    stages = _stages(drive, jobs, now)
    is_over = drive.coming is None and drive.state in STATE_OUTSIDE.values()
    eta_s, eta = etas_of(drive, stages, usual, learnt)
    current = next((stage for stage in stages if stage.state not in ("done",)), None)
    return DriveOut(
        id=drive.id, name=drive.name, vehicle_id=drive.vehicle_id, map_id=drive.map_id, state=drive.state,
        error=drive.error,
        note=_note(drive), quality=_quality(drive), reprocess=_reprocess(drive),
        stage=None if current is None or is_over or drive.state in ("uploading", "removing") else current.stage,
        progress=_share_done(drive, stages, received), eta_s=eta_s,
        eta=eta, warnings=_warnings(drive), stages=stages, files=drive.file_count,
        bytes=drive.byte_count, received_files=received.files, received_bytes=received.bytes, placed=drive.placed,
        images=ImagesOut.model_validate({"state": drive.images, "since": drive.images_since}),
        facts=drive.facts, created_at=drive.created_at, uploaded_at=drive.uploaded_at, finished_at=drive.finished_at,
    )  # fmt: skip


def _warnings(drive: Drive) -> list[str]:
    """Of the result that is shown; of a drive that is being removed none."""
    return [] if drive.state == "removing" else noted_warnings(drive.facts or {})


def _quality(drive: Drive) -> QualityOut | None:
    """The verdict of the gate, and its release."""
    said = shown_verdict(drive)
    if said["gate"] is None:
        return None
    released = (said["released_by"], said["released_why"], said["released_at"])
    release = None if None in released else ReleaseOut(by=released[0], why=released[1], at=released[2])
    by_map = None if said["map_verdict"] is None else MapVerdictOut.model_validate(said["map_verdict"])
    about = {name: said[name] for name in ("grade", "gate")}
    return QualityOut(**about, reasons=said["reasons"] or [], sound=bool(said["sound"]), by_map=by_map, release=release)


def _reprocess(drive: Drive) -> ReprocessOut | None:
    """How far a new run of the drive is."""
    if drive.coming is None:
        return None
    error = drive.coming.get("error") or (drive.error if drive.state == "failed" else None)
    state = "failed" if error else "publishing" if "stitch" in drive.coming else "running"
    return ReprocessOut(since=drive.coming["since"], asked=drive.coming["asked"], state=state, error=error)


def _note(drive: Drive) -> str | None:
    """A few words on why a drive is not in the map, or is there in spite of its grade."""
    said = shown_verdict(drive)
    if said["gate"] in (None, "merge"):
        return "not geo-referenced: no place in the map" if drive.placed is False else None
    if said["released_at"] is not None:
        return f"grade {said['grade']}, released by {said['released_by']}: {said['released_why']}"
    by_map = said["map_verdict"]
    if by_map is not None and by_map["admitted"]:
        return f"in the map, grade {by_map['grade']}: {by_map['reason']}"
    why = "; ".join([*(said["reasons"] or ()), *([by_map["reason"]] if by_map is not None else [])])
    if drive.placed is False:
        return f"held: not geo-referenced, no place in the map: {why}"
    return f"{STATE_OUTSIDE[said['gate'] or 'hold']}: grade {said['grade']}: {why}"


def version_out(session: Session, row: MapVersion) -> VersionOut:
    """Response model of a map version."""
    held = [*maps.drives_of(session, row.map_id, row.version)]
    return VersionOut(
        map_id=row.map_id, version=row.version, created_at=row.created_at, frame=row.frame, drives=held,
        submaps=row.submap_count, bounds=row.bounds, layers=row.layers, tiles=row.tile_count, bytes=row.byte_count, facts=row.facts,
    )  # fmt: skip


def run_out(run: DriveRun) -> RunOut:
    """Response model of a run."""
    labelled = run.stages.get("segmentation", {}).get("parameters", {})
    description = labelled.get("description", {})
    network = NetworkOut(name=description.get("name"), sha256=labelled.get("sha256"), device=labelled.get("device"))
    stages = [
        MadeBy(
            stage=name, key=made["key"], digest=made.get("digest"), code=made.get("code"), libraries=made.get("libraries", {}),
            parameters=sha256_of_json(made["parameters"]) if "parameters" in made else None,
        )
        for name, made in sorted(run.stages.items(), key=lambda item: _position(item[0]))
    ]  # fmt: skip
    return RunOut(number=run.number, created_at=run.created_at, asked=run.asked, network=network, stages=stages)


def run_detail(run: DriveRun) -> RunDetail:
    """Response model of a run with its settings by value."""
    parameters = {name: made.get("parameters", {}) for name, made in run.stages.items()}
    return RunDetail(**run_out(run).model_dump(), submaps=run.submaps, parameters=parameters)


def _position(stage: str) -> int:
    """Of a stage in the order in which drives meet them; one that the catalogue has no more comes last."""
    names = drive_stages()
    return names.index(stage) if stage in names else len(names)


def submap_out(row: SubmapRow) -> SubmapOut:
    """Response model of a submap."""
    covariance = [[value if value is None or math.isfinite(value) else None for value in line] for line in row.covariance]
    return SubmapOut(
        digest=row.digest, drive_id=row.drive_id, position=row.position, points=row.point_count, frame=row.frame,
        bounds=[row.min_lon, row.min_lat, row.max_lon, row.max_lat], T_enu_submap=row.T_enu_submap, covariance=covariance,
    )  # fmt: skip


def _stages(drive: Drive, jobs: Sequence[Job], now: float) -> list[StageOut]:
    """Every stage that the drive will have, those without a row yet as waiting."""
    found = {job.stage: job for job in jobs if not job.part}
    outside = drive.placed is False or (drive.gate is not None and not passes(drive))
    names = drive_stages() if outside and drive.state != "stitching" else (*drive_stages(), *map_stages())
    parts = {name: [job for job in jobs if job.stage == name and job.part] for name in names}
    return [_stage(found[name], parts[name], now) if name in found else _waiting(name) for name in names]


def _stage(job: Job, parts: Sequence[Job], now: float) -> StageOut:
    """A stage by its row, and, while that waits for parts of it, by theirs."""
    if parts and job.state == "waiting":
        return _in_parts(job, parts, now)
    seconds = None if job.started_at is None else max(0.0, (job.finished_at or now) - job.started_at)
    return StageOut(
        stage=job.stage, state=job.state, progress=job.progress, message=job.message, attempt=job.attempt, error=job.error,
        started_at=job.started_at, finished_at=job.finished_at, seconds=seconds if job.state != "queued" else None,
        losses=[LossOut.model_validate(one) for one in job.losses],
    )  # fmt: skip


def _in_parts(job: Job, parts: Sequence[Job], now: float) -> StageOut:
    """Running while a part runs or is done; the share of all parts."""
    started = [part.started_at for part in parts if part.started_at is not None]
    done = sum(part.state == "done" for part in parts)
    failed = next((part for part in parts if part.state == "failed"), None)
    return StageOut(
        stage=job.stage, state="failed" if failed else "running" if started else "queued",
        progress=sum(1.0 if part.state == "done" else part.progress for part in parts) / len(parts),
        message=f"{done} of {len(parts)} parts are done", attempt=max(part.attempt for part in parts),
        error=None if failed is None else failed.error, started_at=min(started, default=None), finished_at=None,
        seconds=max(0.0, now - min(started)) if started else None,
    )  # fmt: skip


def _waiting(name: str) -> StageOut:
    return StageOut(
        stage=name, state="waiting", progress=0, message="", attempt=0, error=None, started_at=None, finished_at=None, seconds=None
    )


def _share_done(drive: Drive, stages: Sequence[StageOut], received: Received) -> float:
    """The received share while the drive arrives, then the share of stages done."""
    if drive.state == "uploading":
        return received.bytes / drive.byte_count if drive.byte_count else 0.0
    return sum(stage.progress for stage in stages) / len(stages)
