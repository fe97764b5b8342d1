"""Odometry stage: the drive tracked with its rig's lens.

Leaves odometry.npz, evidence.npz (for `wayloom calibrate`) and report.json.
"""

import hashlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.calibration.rig_file import RigFile, rig_for_log, text_of
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
    rig, collector = rig_for_log(settings.rig, log)[0], ObservationCollector(log.rig)
    matches = context.first_matches
    result = track_calibrated(log, settings.odometry, progress, settings.threads, None, (collector,), matches, rig)
    result.report["rig"] = None if rig is None else _version(rig)
    if not np.isfinite(result.trajectory.T_world_cam).all():
        raise StageError("the odometry gave poses that are not finite: please report this drive as a fault of wayloom")
    save_odometry(result, out_dir / ODOMETRY_FILE)
    save_observations(collector.observations(log), out_dir / EVIDENCE_FILE)
    write_report(out_dir, result.report)


def key_parts(context: StageContext) -> dict[str, Any]:
    """The rig file by what it says, whatever its name. Raises CalibrationError for another rig's file."""
    rig, _ = rig_for_log(context.settings.rig, context.log)
    return {"rig": None if rig is None else _version(rig)["sha256"]}


def _version(rig: RigFile) -> dict[str, Any]:
    """What a result says of the rig file that it was made with."""
    sha256 = hashlib.sha256(text_of(rig).encode()).hexdigest()
    return {"sha256": sha256, "drives": len(rig.drives), "drives_with_gnss": rig.scales, "baseline_ratio": rig.baseline_ratio}
