"""Odometry stage: the drive tracked with its rig's lens.

Leaves odometry.npz, evidence.npz (for `wayloom calibrate`) and report.json.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.calibration.rig_file import lens_for_log
from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.progress import Progress
from wayloom.errors import StageError
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, save_odometry
from wayloom.odometry.rig.calibration_file import save_observations
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_report import write_report

EVIDENCE_FILE: Final = "evidence.npz"


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises LogError or CalibrationError where the drive cannot be tracked, StageError where a pose is not finite."""
    log, settings = context.log, context.settings
    lens, collector = lens_for_log(settings.rig, log)[0], ObservationCollector(log.rig)
    matches = context.first_matches
    result = track_calibrated(log, settings.odometry, progress, settings.threads, lens, (collector,), matches)
    if not np.isfinite(result.trajectory.T_world_cam).all():
        raise StageError("the odometry gave poses that are not finite: please report this drive as a fault of wayloom")
    save_odometry(result, out_dir / ODOMETRY_FILE)
    save_observations(collector.observations(log), out_dir / EVIDENCE_FILE)
    write_report(out_dir, result.report)


def key_parts(context: StageContext) -> dict[str, Any]:
    """The lens of the rig file, whatever the file's name. Raises CalibrationError for another rig's file."""
    lens, _ = lens_for_log(context.settings.rig, context.log)
    return {"lens": None if lens is None else lens.values.tolist()}
