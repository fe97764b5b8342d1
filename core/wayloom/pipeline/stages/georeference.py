"""Geo-reference stage: the drive's trajectory in the map's ENU frame. Leaves georeference.npz and report.json."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.georeference.alignment import georeference
from wayloom.georeference.files import GEOREFERENCE_FILE, save_georeference
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_report import write_report
from wayloom.pipeline.tracked_drive import tracked_drive


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where no place fits the fixes."""
    settings = context.settings
    labels = load_labels(context.inputs_dir / "labelling" / LABELS_FILE)
    geo = georeference(
        context.log, tracked_drive(context), settings.map_frame(), settings.georeference, progress, labels=labels
    )
    save_georeference(geo, out_dir / GEOREFERENCE_FILE)
    write_report(out_dir, geo.report)
