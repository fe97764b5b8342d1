"""Loop stage: places that the drive passes again, registered to each other. Leaves loops.npz and report.json."""

from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.loops.files import LOOPS_FILE, save_loops
from wayloom.loops.search import find_loops
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_report import write_report
from wayloom.places.files import PLACES_FILE, load_places


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises InputError where the drive's places cannot be read."""
    places = load_places(context.inputs_dir / "places" / PLACES_FILE)
    loops = find_loops(places, context.settings.loops, progress)
    save_loops(loops, out_dir / LOOPS_FILE)
    write_report(out_dir, loops.report)
