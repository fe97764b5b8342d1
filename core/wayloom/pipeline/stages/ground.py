"""Ground stage: height, classes and orthophoto of the ground along each submap. Leaves index.json and one file a sheet."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.ground.files import save_sheets
from wayloom.ground.making import make_sheets
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.files import StoredSubmaps


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where an image's labels are missing, LogError where an image is."""
    odometry = tracked_drive(context, "way")
    images = KeyframeLabels(context.inputs_dir / "segmentation", odometry.keyframes.frame)
    submaps, settings = StoredSubmaps(context.inputs_dir / "submaps"), context.settings
    save_sheets(make_sheets(context.log, odometry, images, submaps, settings.ground, progress, settings.threads), out_dir)
