"""Places stage: what is kept of a drive to recognise and register its places without its images. Leaves drive.places."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.places.cloud import hosted_points
from wayloom.places.extraction import make_places
from wayloom.places.files import PLACES_FILE, save_places
from wayloom.segmentation.keyframe_labels import KeyframeLabels


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where labels and points do not belong together or an image's labels are missing, LogError where an image
    is."""
    settings, labels_file = context.settings, context.inputs_dir / "labelling" / LABELS_FILE
    hosted = hosted_points(tracked_drive(context, "points"), load_labels(labels_file, votes=False), settings.places)
    odometry = tracked_drive(context, "way")
    images = KeyframeLabels(context.inputs_dir / "segmentation", odometry.keyframes.frame)
    places = make_places(context.log, odometry, hosted, images, settings.places, progress, settings.threads)
    save_places(places, out_dir / PLACES_FILE)
