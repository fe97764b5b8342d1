"""Odometry stage: the drive tracked with its rig's lens, a long one in parts.

Leaves odometry.npz, evidence.npz (for `wayloom calibrate`) and report.json.
"""

import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from wayloom.calibration.rig_file import rig_for_log
from wayloom.config.progress import Progress
from wayloom.odometry.held_images import held_images, release
from wayloom.odometry.observers import KeyframeCaller, Observer
from wayloom.odometry.odometry import track
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.odometry.rig.collecting_alongside import CollectingAlongside
from wayloom.pipeline import odometry_parts, part_processes
from wayloom.pipeline.odometry_parts import EVIDENCE_FILE as EVIDENCE_FILE
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import is_undamaged


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises LogError or CalibrationError where the drive cannot be tracked, StageError where a pose is not finite."""
    if len(odometry_parts.parts_of(context)) == 1:
        _track_whole(context, out_dir, progress)
        return
    temporary = nullcontext(context.parts_dir) if context.parts_dir is not None else tempfile.TemporaryDirectory(prefix="wayloom-")
    with temporary as parts_dir:
        _track_in_parts(context, Path(str(parts_dir)), out_dir, progress)


def missing_parts(context: StageContext, parts_dir: Path, progress: Progress) -> list[int]:
    """The parts that are still to be tracked, after the drive is calibrated; none of a drive that is tracked in one piece."""
    if len(odometry_parts.parts_of(context)) == 1:
        return []
    odometry_parts.prepare_parts(context, parts_dir, progress)
    return [part.number for part in odometry_parts.missing_parts(context, parts_dir)]


def has_part(parts_dir: Path, number: int) -> bool:
    """Whether a part is finished and its files are those that were written."""
    return is_undamaged(parts_dir / part_name(number))


def make_part(context: StageContext, number: int, out_dir: Path, progress: Progress) -> None:
    """Track one part. Raises as `run`."""
    assert context.parts_dir is not None
    known = odometry_parts.load_calibration(context.parts_dir)
    odometry_parts.track_part(context, odometry_parts.parts_of(context)[number], known, out_dir, progress)


def part_name(number: int) -> str:
    """Of the folder of a finished part."""
    return odometry_parts.part_name(number)


def _track_whole(context: StageContext, out_dir: Path, progress: Progress) -> None:
    log = held_images(context.log)
    known = odometry_parts.calibrate(context, log, progress)
    release(log)
    settings, collector = known.settings(context.settings.odometry), ObservationCollector(log.rig)
    threads, ratio = context.settings.threads, known.baseline_ratio
    observers: list[Observer] = [CollectingAlongside(collector) if threads > 1 else collector]
    if context.ahead is not None:
        observers.append(KeyframeCaller(context.ahead.on_keyframe))
    result = track(log, settings, progress, threads, known.lens, observers, known.matches, ratio)
    observations = collector.observations(log)
    odometry_parts.write_result(known.complete(result, observations), observations, out_dir)


def _track_in_parts(context: StageContext, parts_dir: Path, out_dir: Path, progress: Progress) -> None:
    """Whatever parts are missing, in as many processes as there are threads, and then all joined."""
    odometry_parts.prepare_parts(context, parts_dir, progress)
    missing, parts = odometry_parts.missing_parts(context, parts_dir), odometry_parts.parts_of(context)
    if min(len(missing), context.settings.threads) > 1:
        part_processes.track_in_processes(context, missing, parts_dir, progress)
        missing = odometry_parts.missing_parts(context, parts_dir)  # of a process that failed: it fails here again, and says why
    for part in missing:
        told = odometry_parts.share_of_all(progress, parts, part)
        odometry_parts.track_part_at_home(context, part, parts_dir, told)
    odometry_parts.join(context, parts_dir, out_dir)


def key_parts(context: StageContext) -> dict[str, Any]:
    """The rig file by what it says of the cameras, whatever its name. Raises CalibrationError for another rig's file."""
    rig, _ = rig_for_log(context.settings.rig, context.log)
    return {"rig": None if rig is None else odometry_parts.rig_version(replace(rig, receivers=()))["sha256"]}
