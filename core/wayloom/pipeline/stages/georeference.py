"""Geo-reference stage: the drive's trajectory in the map's ENU frame.

Leaves georeference.npz, quality.json and report.json.
"""

from pathlib import Path
from typing import Any

from wayloom.calibration.receiver import ReceiverEvidence
from wayloom.calibration.rig_file import rig_for_log
from wayloom.config.progress import Progress
from wayloom.georeference.alignment import georeference
from wayloom.georeference.files import GEOREFERENCE_FILE, save_georeference
from wayloom.georeference.gravity.witnesses import SeenUp, seen_up
from wayloom.georeference.types import Wanted
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.loops.files import LOOPS_FILE, load_loops
from wayloom.odometry.rig.drive_name import drive_name
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.drive_quality import QUALITY_FILE, drive_quality, write_quality
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_report import write_report
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.submaps.split import anchor_frames, split_road


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where no place fits the fixes."""
    settings = context.settings
    up = _seen_up(context)
    odometry = tracked_drive(context, "way")
    closures = load_loops(context.inputs_dir / "loops" / LOOPS_FILE)
    wanted = Wanted(settings.map_frame(), anchor_frames(odometry, split_road(odometry, settings.submaps)))
    geo = georeference(context.log, odometry, wanted, settings.georeference, progress, closures, up, rig_receiver(context))
    save_georeference(geo, out_dir / GEOREFERENCE_FILE)
    write_quality(out_dir / QUALITY_FILE, drive_quality(odometry, geo, closures))
    write_report(out_dir, geo.report)


def _seen_up(context: StageContext) -> SeenUp:
    """By the labelled points, which nothing else here asks for."""
    labels = load_labels(context.inputs_dir / "labelling" / LABELS_FILE, votes=False)
    return seen_up(context.log, tracked_drive(context, "points"), labels, context.settings.georeference)


def rig_receiver(context: StageContext) -> tuple[ReceiverEvidence, ...]:
    """What other drives of the rig tell of its GNSS clock and lever arm. Raises CalibrationError for another rig's file."""
    rig, _ = rig_for_log(context.settings.rig, context.log)
    own = drive_name(context.log)
    return () if rig is None else tuple(one for one in rig.receivers if one.drive_id != own)


def key_parts(context: StageContext) -> dict[str, Any]:
    """The rig file by what it says of the receiver. Raises CalibrationError for another rig's file."""
    told = [[one.drive_id, one.t_ns, one.information.tolist(), one.pull.tolist()] for one in rig_receiver(context)]
    return {"receiver": sha256_of_json(told) if told else None}
