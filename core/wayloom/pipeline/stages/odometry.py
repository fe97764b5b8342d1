"""Odometry stage: the drive tracked with its rig's lens, a long one in parts.

Leaves odometry.npz, evidence.npz (for `wayloom calibrate`) and report.json.
"""

import tempfile
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from wayloom.calibration.rig_file import lens_for_log
from wayloom.config.progress import Progress
from wayloom.odometry.odometry import track
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.pipeline import odometry_parts, part_processes
from wayloom.pipeline.odometry_parts import EVIDENCE_FILE as EVIDENCE_FILE
from wayloom.pipeline.stage_context import StageContext


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises LogError or CalibrationError where the drive cannot be tracked, StageError where a pose is not finite."""
    if len(odometry_parts.parts_of(context)) == 1:
        _track_whole(context, out_dir, progress)
        return
    temporary = nullcontext(context.parts_dir) if context.parts_dir is not None else tempfile.TemporaryDirectory(prefix="wayloom-")
    with temporary as parts_dir:
        _track_in_parts(context, Path(str(parts_dir)), out_dir, progress)


def _track_whole(context: StageContext, out_dir: Path, progress: Progress) -> None:
    log, known = context.log, odometry_parts.calibrate(context, progress)
    settings, collector = known.settings(context.settings.odometry), ObservationCollector(log.rig)
    result = track(log, settings, progress, context.settings.threads, known.lens, (collector,), known.matches)
    odometry_parts.write_result(known.complete(result), collector.observations(log), out_dir)


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
    """The lens of the rig file, whatever the file's name. Raises CalibrationError for another rig's file."""
    lens, _ = lens_for_log(context.settings.rig, context.log)
    return {"lens": None if lens is None else lens.values.tolist()}
