"""Objects stage: poles, signs, lights and trunks that the drive saw along each submap. Leaves index.json and a file a submap."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.sheet import GroundSheet
from wayloom.objects.files import save_all
from wayloom.objects.making import find_objects
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.files import StoredSubmaps


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where an image's labels are missing, LogError where an image is, InputError for a damaged sheet."""
    odometry = tracked_drive(context, "way")
    images = KeyframeLabels(context.inputs_dir / "segmentation", odometry.keyframes.frame)
    submaps = StoredSubmaps(context.inputs_dir / "submaps")
    sheets_dir = context.inputs_dir / "ground"
    sheets = read_index(sheets_dir)

    def sheet_of(submap: str) -> GroundSheet | None:
        return load_sheet(sheets_dir, sheets[submap]) if submap in sheets else None

    settings = context.settings
    found = find_objects(context.log, odometry, images, submaps, sheet_of, settings.objects, progress, settings.threads)
    save_all(found, out_dir)
