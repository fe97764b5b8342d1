"""Embedded run of one drive on one page: check the log → its stages, in the catalogue's order → exports and report."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from wayloom.config.progress import NamedProgress, Progress, silent_for_each
from wayloom.config.stages import INGEST, drive_stages
from wayloom.exports.drive_origin import REPORT_FILE
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.logs.registry import check_outside
from wayloom.odometry.frame_source import first_matches, one_opencv_thread
from wayloom.pipeline.drive_result import DriveResult, StageTime
from wayloom.pipeline.folders import discard, new_folders, put_in_place, sole_writer, sweep, whole_folder, writing_to
from wayloom.pipeline.labels_ahead import labels_ahead
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import compile_for, run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import finished_key, is_undamaged, read_stage_file
from wayloom.pipeline.stages.odometry import key_parts as lens_of_rig_file
from wayloom.pipeline.stages.segmentation import network_of
from wayloom.pipeline.stages_in_turn import in_turn

STAGES_DIR: Final = "stages"
EXPORTS: Final = "exports"
"""What follows the stages, in progress and among those whose kernels are listed."""
PRODUCTS_FILE: Final = "products.json"
PARTS_SUFFIX: Final = ".parts"
NEARLY_DONE: Final = 0.999


def process_drive(
    log_path: Path,
    out_dir: Path,
    settings: ProcessSettings = ProcessSettings(),
    gnss_path: Path | None = None,
    progress: NamedProgress = silent_for_each,
    write_more: Callable[[DriveResult, Path], None] = lambda result, folder: None,
) -> DriveResult:
    """Map one drive. Stages that an earlier run finished, with the same inputs, settings and code, are not run again.

    out_dir gets `stages/`, and, each by one rename and only when all are written, what `write_exports` and write_more leave.
    progress : of each stage by its name, and of "exports"; with two threads or more these begin while objects are still looked for
    write_more : called with the result and the folder in which the finished files are gathered, when those of `write_exports` are
        there (reports use it)
    Raises InputError for a bad log, network or setting, and for an out_dir that cannot be written; a bad log leaves no trace.
    """
    stages_dir = out_dir / STAGES_DIR
    context = StageContext(LogSource(log_path, gnss_path), stages_dir, settings)
    check_outside(context.log, out_dir)
    geoid = None if settings.geoid is None else GeoidGrid(settings.geoid)
    context = replace(context, network=network_of(settings))
    lens_of_rig_file(context)
    with writing_to(out_dir), new_folders(stages_dir), sole_writer(stages_dir):
        context = _started(context, progress)
        sweep(stages_dir)
        with whole_folder(stages_dir / "exports") as folder, labels_ahead(context) as followed:

            def products(wait_for_all: Callable[[], dict[str, StageTime]]) -> DriveResult:
                from wayloom.pipeline.drive_products import write_products  # loaded beside objects that are still looked for

                return write_products(context, folder, geoid, write_more, progress(EXPORTS), wait_for_all)

            result = in_turn(partial(_stage, followed), progress, settings.threads, products)
        _publish(stages_dir / "exports", out_dir)
        progress(EXPORTS)(1.0, f"written to {out_dir}")
    return result


def _started(context: StageContext, progress: NamedProgress) -> StageContext:
    """The context with the first pairs' matches, when all kernels are compiled: a rig that cannot be used is told before anything
    is made."""
    progress(INGEST)(0.0, "looking at the first pairs")
    compile_for((*drive_stages(), EXPORTS), context, progress(INGEST))
    with one_opencv_thread():
        return replace(context, first_matches=first_matches(context.log, context.settings.odometry.row_frames))


def _publish(gathered: Path, out_dir: Path) -> None:
    """Move each product into out_dir, report.json last, and remove those of an earlier run that this one does not have."""
    names = sorted((path.name for path in gathered.iterdir()), key=lambda name: (name == REPORT_FILE, name))
    listing = gathered.parent / PRODUCTS_FILE
    earlier = json.loads(listing.read_text()) if listing.exists() else []
    write_atomically(listing, json.dumps(sorted({*earlier, *names})).encode())
    for name in set(earlier) - set(names):
        discard(out_dir / Path(name).name)
    for name in names:
        put_in_place(gathered / name, out_dir / name)
    gathered.rmdir()
    write_atomically(listing, json.dumps(names).encode())


def _stage(context: StageContext, name: str, progress: NamedProgress, threads: int, /) -> StageTime:
    """Run a stage by so many threads, or find that its result is there."""
    context = replace(context, settings=context.settings.model_copy(update={"threads": threads}))
    key = stage_key(name, context)
    home = context.inputs_dir / name
    reused = finished_key(home) == key.hex and is_undamaged(home)
    progress(name)(0.0, "starting")
    if not reused:
        with _parts_folder(home, key.hex) as parts_dir, whole_folder(home) as folder:
            run_stage(name, replace(context, parts_dir=parts_dir), folder, _almost_done(progress(name)), key)
    metadata = read_stage_file(home) or {}
    progress(name)(1.0, "done before" if reused else "done")
    return StageTime(float(metadata.get("seconds", 0.0)), reused)


@contextmanager
def _parts_folder(home: Path, key: str) -> Iterator[Path]:
    """Where a stage may keep finished parts for a run after this one; gone with those of other keys when the block ends well."""
    parts = home.with_name(home.name + PARTS_SUFFIX)
    for other in parts.glob("*") if parts.is_dir() else ():
        if other.name != key:
            discard(other)
    if (parts / key).is_dir():
        sweep(parts / key)
    yield parts / key
    discard(parts)


def _almost_done(progress: Progress) -> Progress:
    """The progress of a stage's work, which is done only when its folder is in place."""
    return lambda share, what, /: progress(min(share, NEARLY_DONE), what)
