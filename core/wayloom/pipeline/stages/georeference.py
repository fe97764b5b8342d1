"""Geo-reference stage: the drive's trajectory in the map's ENU frame.

Leaves georeference.npz, quality.json and report.json.
"""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.georeference.alignment import georeference
from wayloom.georeference.files import GEOREFERENCE_FILE, save_georeference
from wayloom.pipeline.drive_quality import QUALITY_FILE, drive_quality, write_quality
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_report import write_report
from wayloom.pipeline.tracked_drive import tracked_drive


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises StageError where no place fits the fixes."""
    settings = context.settings
    odometry = tracked_drive(context)
    geo = georeference(context.log, odometry, settings.map_frame(), settings.georeference, progress)
    save_georeference(geo, out_dir / GEOREFERENCE_FILE)
    write_quality(out_dir / QUALITY_FILE, drive_quality(odometry, geo))
    write_report(out_dir, geo.report)
