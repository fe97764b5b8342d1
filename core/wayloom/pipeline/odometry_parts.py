"""Odometry of a long drive in parts: calibrated once, each part tracked into a folder of its own, all joined at the end.

The folder of the parts (`StageContext.parts_dir`) belongs to one key of the stage. It holds calibration.npz, and for each finished
part a folder by its number with odometry.npz, evidence.npz and, written last, stage.json. So a run that was killed goes on with the
parts that are whole, and several processes or workers can track parts of one drive: what they make does not depend on who does.
"""

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.calibration.rig_file import RigFile, rig_for_log, text_of
from wayloom.calibration.self_calibration import DriveCalibration, calibrate_drive
from wayloom.config.progress import Progress
from wayloom.errors import StageError
from wayloom.files.atomic import replacing
from wayloom.geometry.lens import lens_from_values
from wayloom.logs.types import DriveLog
from wayloom.odometry.odometry import track
from wayloom.odometry.parts.join import join_parts
from wayloom.odometry.parts.log_view import log_view
from wayloom.odometry.parts.observations import join_observations
from wayloom.odometry.parts.plan import DrivePart, plan_parts
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry, save_odometry
from wayloom.odometry.rig.calibration_file import load_observations, save_observations
from wayloom.odometry.rig.calibration_observations import CalibrationObservations, ObservationCollector
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.folders import whole_folder
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import STAGE_FILE, digest_of_folder, is_undamaged
from wayloom.pipeline.stage_report import REPORT_FILE, write_report

CALIBRATION_FILE: Final = "calibration.npz"
EVIDENCE_FILE: Final = "evidence.npz"


def parts_of(context: StageContext) -> list[DrivePart]:
    """The parts in which the drive is tracked; one that is the whole drive where it is short."""
    return plan_parts(len(context.log), context.settings.odometry)


def part_folder(parts_dir: Path, part: DrivePart) -> Path:
    """Where a finished part lies."""
    return parts_dir / part_name(part.number)


def part_name(number: int) -> str:
    """Of the folder of a finished part."""
    return f"{number:04d}"


def missing_parts(context: StageContext, parts_dir: Path) -> list[DrivePart]:
    """The parts that are not finished, or whose files are not those that were written."""
    return [part for part in parts_of(context) if not is_undamaged(part_folder(parts_dir, part))]


def calibrate(context: StageContext, log: DriveLog, progress: Progress) -> DriveCalibration:
    """What the drive of that log is tracked with: what is known of its rig, or its own lens. Raises LogError, CalibrationError."""
    rig = rig_for_log(context.settings.rig, log)[0]
    settings, matches = context.settings, context.first_matches
    found = calibrate_drive(log, settings.odometry, progress, matches=matches, rig=rig, threads=settings.threads)
    return replace(found, report=found.report | {"rig": None if rig is None else rig_version(rig)})


def rig_version(rig: RigFile) -> dict[str, Any]:
    """What a result says of the rig file that it was made with."""
    sha256 = hashlib.sha256(text_of(rig).encode()).hexdigest()
    return {"sha256": sha256, "drives": len(rig.drives), "drives_with_gnss": rig.scales, "baseline_ratio": rig.baseline_ratio}


def prepare_parts(context: StageContext, parts_dir: Path, progress: Progress) -> None:
    """Calibrate the drive for all its parts, unless that is done. Raises LogError, CalibrationError."""
    file = parts_dir / CALIBRATION_FILE
    if not file.exists():
        found = calibrate(context, context.log, progress)
        matches = np.zeros((0, 4)) if found.matches is None else found.matches
        covariance = np.zeros((0, 0)) if found.covariance is None else found.covariance
        numbers = {name: getattr(found, name) for name in ("bias_prior", "baseline_ratio", "bias_sigma_px")}
        about = json.dumps({**numbers, "report": found.report, "has_matches": found.matches is not None})
        with replacing(file) as stream:
            np.savez(stream, lens=found.lens.values, matches=matches, covariance=covariance, about=np.array(about))


def load_calibration(parts_dir: Path) -> DriveCalibration:
    """What `prepare_parts` left. Raises StageError where it is gone."""
    file = parts_dir / CALIBRATION_FILE
    try:
        with np.load(file) as content:
            about = json.loads(str(content["about"]))
            matches = content["matches"] if about["has_matches"] else None
            lens, covariance = lens_from_values(content["lens"]), content["covariance"] if content["covariance"].size else None
            numbers = {name: float(about[name]) for name in ("bias_prior", "baseline_ratio", "bias_sigma_px")}
            return DriveCalibration(lens, matches, report=about["report"], covariance=covariance, **numbers)
    except (OSError, ValueError, KeyError) as problem:
        raise StageError(f"{file} cannot be read ({problem}): run the odometry again") from problem


def track_part(context: StageContext, part: DrivePart, known: DriveCalibration, out_dir: Path, progress: Progress) -> None:
    """Track one part into out_dir, which exists and is empty. Raises LogError, StageError."""
    start = time.perf_counter()
    view, collector = log_view(context.log, part.first, part.stop), ObservationCollector(context.log.rig)
    settings = known.settings(context.settings.odometry)
    threads, ratio = context.settings.threads, known.baseline_ratio
    result = track(view, settings, progress, threads, known.lens, (collector,), known.matches, ratio)
    write_result(result, collector.observations(view), out_dir)
    metadata = {"key": part.number, "digest": digest_of_folder(out_dir), "seconds": round(time.perf_counter() - start, 3)}
    (out_dir / STAGE_FILE).write_text(json.dumps(metadata) + "\n")


def track_part_at_home(context: StageContext, part: DrivePart, parts_dir: Path, progress: Progress) -> None:
    """Track one part into its place among the parts, where it appears when it is whole."""
    with whole_folder(part_folder(parts_dir, part)) as folder:
        track_part(context, part, load_calibration(parts_dir), folder, progress)


def join(context: StageContext, parts_dir: Path, out_dir: Path) -> None:
    """The finished parts as the result of the stage."""
    parts = parts_of(context)
    homes = {part.number: part_folder(parts_dir, part) for part in parts}
    result = join_parts(parts, lambda part: _with_times(homes[part.number]))
    evidence = [(part, load_observations(homes[part.number] / EVIDENCE_FILE)) for part in parts]
    observations = join_observations(context.log, evidence)
    write_result(load_calibration(parts_dir).complete(result, observations), observations, out_dir)


def write_result(result: OdometryResult, observations: CalibrationObservations, out_dir: Path) -> None:
    """odometry.npz, evidence.npz, report.json. Raises StageError where a pose is not finite."""
    if not np.isfinite(result.trajectory.T_world_cam).all():
        raise StageError("the odometry gave poses that are not finite: please report this drive as a fault of wayloom")
    save_odometry(result, out_dir / ODOMETRY_FILE)
    save_observations(observations, out_dir / EVIDENCE_FILE)
    write_report(out_dir, result.report)


def _with_times(folder: Path) -> OdometryResult:
    """A part's result, its report with the times, which its file leaves out."""
    result = load_odometry(folder / ODOMETRY_FILE)
    report: dict[str, Any] = json.loads((folder / REPORT_FILE).read_text())
    return replace(result, report=result.report | {"seconds": report["seconds"]})


def share_of_all(progress: Progress, parts: Sequence[DrivePart], part: DrivePart) -> Progress:
    """The progress of one part of a run that does one after the other."""
    total, before = sum(map(len, parts)), sum(len(other) for other in parts if other.number < part.number)
    return partial(_tell, progress, before / total, len(part) / total, f"part {part.number + 1} of {len(parts)}: ")


def _tell(progress: Progress, before: float, share_of_part: float, name: str, share: float, what: str, /) -> None:
    progress(before + share_of_part * share, name + what)
