"""Submap stage: the labelled, geo-referenced drive cut into submaps. Leaves index.json, one file a submap, and preview.png."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from wayloom.config.progress import Progress
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.types import GeoReference
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.pipeline.drive_map import drive_map, write_image
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.tracked_drive import tracked_drive
from wayloom.submaps.files import StoredSubmaps, save_submaps
from wayloom.submaps.split import make_submaps
from wayloom.submaps.submap import PlacedSubmap

PREVIEW_FILE: Final = "preview.png"


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where labels and points do not belong together."""
    geo = load_georeference(context.inputs_dir / "georeference" / GEOREFERENCE_FILE)
    progress(0.0, "cutting the drive into submaps")
    save_submaps(_made(context, geo), out_dir)
    stored = StoredSubmaps(out_dir)
    progress(0.8, f"drawing {len(stored)} submaps")
    write_image(out_dir / PREVIEW_FILE, drive_map(geo, stored))


def _made(context: StageContext, geo: GeoReference) -> Iterator[PlacedSubmap]:
    """The submaps, one at a time in memory; the drive and its labels are let go of after the last."""
    odometry = tracked_drive(context, "points")
    labels = load_labels(context.inputs_dir / "labelling" / LABELS_FILE)
    yield from make_submaps(context.log, odometry, labels, geo, context.settings.submaps, context.drive_id)
