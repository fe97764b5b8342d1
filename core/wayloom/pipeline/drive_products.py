"""Products of a processed drive: what it leaves for people and other programs, written while its objects are still looked for.

Its imports are many and slow; `process_drive` loads it when there is something to write.
"""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.ground.exports import export_ground
from wayloom.ground.markings.exports import MARKINGS_FILE, export_markings
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.objects.exports import OBJECTS_FILE, export_objects, objects_of_drive
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry, observations_stored
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality
from wayloom.pipeline.drive_result import DriveResult, StageTime
from wayloom.pipeline.exports import DENSE_FILE, write_dense, write_exports
from wayloom.pipeline.log_parts import read_log_file
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.segmentation.keyframe_labels import MODEL_FILE, KeyframeLabels
from wayloom.submaps.files import StoredSubmaps


def write_products(
    context: StageContext,
    folder: Path,
    geoid: GeoidGrid | None,
    write_more: Callable[[DriveResult, Path], None],
    progress: Progress,
    wait_for_all: Callable[[], dict[str, StageTime]],
) -> DriveResult:
    """Write a drive's products into the folder, what its objects are for when they are there."""
    mapped, settings, stages_dir = _load(context), context.settings, context.inputs_dir
    progress(0.0, "writing trajectory, cloud and pictures")
    with _beside(_ground_and_dense(mapped, settings, stages_dir / "ground", folder, geoid), settings.threads - 1):
        write_exports(mapped.log, mapped.odometry, mapped.images, mapped.geo, mapped.submaps, folder, geoid, stages_dir)
        times = wait_for_all()
        progress(0.5, "writing objects and report")
        objects = objects_of_drive(stages_dir / "objects", mapped.submaps, settings.object_fusion)
        if mapped.geo.frame is not None:
            export_objects(objects, mapped.geo.frame, folder / OBJECTS_FILE)
        result = replace(mapped, objects=objects, times=times)
        write_more(result, folder)
    return result


def _ground_and_dense(
    mapped: DriveResult, settings: ProcessSettings, sheets_dir: Path, folder: Path, geoid: GeoidGrid | None
) -> list[Callable[[], None]]:
    """What writes them, each for itself, the longest first."""
    about = (mapped.log, mapped.odometry, mapped.images, mapped.submaps)

    def dense() -> None:
        write_dense(*about, folder / DENSE_FILE, mapped.geo.frame, geoid, settings.looks)

    return [
        *([dense] if settings.dense else []),
        lambda: export_markings(sheets_dir, mapped.submaps, folder / MARKINGS_FILE, settings.markings, settings.kerbs),
        lambda: export_ground(sheets_dir, mapped.submaps, folder),
    ]


@contextmanager
def _beside(work: list[Callable[[], None]], threads: int) -> Iterator[None]:
    """Do all of it beside the block, by so many threads; without one before it."""
    if threads < 1:
        for one in work:
            one()
        yield
        return
    with ThreadPoolExecutor(threads) as pool:
        done = [pool.submit(one) for one in work]
        try:
            yield
            for future in done:
                future.result()
        finally:
            for future in done:
                future.cancel()


def _load(context: StageContext) -> DriveResult:
    """All but the objects and the times."""
    stages_dir = context.inputs_dir
    tracked = stages_dir / "odometry" / ODOMETRY_FILE
    odometry = load_odometry(tracked, "way")
    return DriveResult(
        log=context.log,
        log_facts=read_log_file(stages_dir / "ingest"),
        model=json.loads((stages_dir / "segmentation" / MODEL_FILE).read_text()),
        odometry=odometry,
        observations=observations_stored(tracked),
        images=KeyframeLabels(stages_dir / "segmentation", odometry.keyframes.frame),
        labels=load_labels(stages_dir / "labelling" / LABELS_FILE, votes=False),
        geo=load_georeference(stages_dir / "georeference" / GEOREFERENCE_FILE),
        submaps=StoredSubmaps(stages_dir / "submaps"),
        quality=read_quality(stages_dir / "georeference" / QUALITY_FILE),
    )
