"""Looks stage: how far the drive saw, in small depth images that outlive its images. Leaves drive.looks."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.dense.extraction import make_looks
from wayloom.dense.files import LOOKS_FILE, save_looks
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.segmentation.keyframe_labels import KeyframeLabels


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where an image's labels are missing, LogError where an image is."""
    odometry = tracked_drive(context, "way")
    images = KeyframeLabels(context.inputs_dir / "segmentation", odometry.keyframes.frame)
    settings = context.settings
    save_looks(make_looks(context.log, odometry, images, settings.looks, progress, settings.threads), out_dir / LOOKS_FILE)
