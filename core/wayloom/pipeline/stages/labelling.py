"""Labelling stage: temporally consistent labels of the odometry's points. Leaves labels.npz."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.labelling.files import LABELS_FILE, save_labels
from wayloom.labelling.tcl import label_points
from wayloom.labelling.voting_frames import voting_frames
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.segmentation.keyframe_labels import KeyframeLabels


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where an image's labels are missing."""
    odometry, settings = tracked_drive(context), context.settings.labelling
    images = KeyframeLabels(context.inputs_dir / "segmentation", voting_frames(odometry, settings))
    save_labels(label_points(odometry, images, settings, progress), out_dir / LABELS_FILE)
