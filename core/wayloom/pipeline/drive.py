"""Embedded run of one drive on one page: check the log → its stages, in the catalogue's order → exports and report."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from wayloom.config.progress import NamedProgress, Progress, silent_for_each
from wayloom.config.stages import INGEST, drive_stages
from wayloom.exports.drive_origin import REPORT_FILE
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.types import GeoReference
from wayloom.ground.exports import export_ground
from wayloom.ground.markings.exports import MARKINGS_FILE, export_markings
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.labelling.types import PointLabels
from wayloom.logs.registry import check_outside
from wayloom.logs.types import DriveLog
from wayloom.objects.exports import OBJECTS_FILE, export_objects, objects_of_drive
from wayloom.objects.types import MapObject
from wayloom.odometry.frame_source import first_matches, one_opencv_thread
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry, observations_stored
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality
from wayloom.pipeline.exports import DENSE_FILE, write_dense, write_exports
from wayloom.pipeline.folders import discard, new_folders, put_in_place, sole_writer, sweep, whole_folder, writing_to
from wayloom.pipeline.labels_ahead import labels_ahead
from wayloom.pipeline.log_parts import read_log_file
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import compile_for, run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import finished_key, is_undamaged, read_stage_file
from wayloom.pipeline.stages.odometry import key_parts as lens_of_rig_file
from wayloom.pipeline.stages.segmentation import network_of
from wayloom.pipeline.stages_in_turn import in_turn
from wayloom.segmentation.keyframe_labels import MODEL_FILE, KeyframeLabels
from wayloom.submaps.files import StoredSubmaps
from wayloom.submaps.submap import PlacedSubmap

STAGES_DIR: Final = "stages"
EXPORTS: Final = "exports"
"""What follows the stages, in progress and among those whose kernels are listed."""
PRODUCTS_FILE: Final = "products.json"
PARTS_SUFFIX: Final = ".parts"
NEARLY_DONE: Final = 0.999


@dataclass(frozen=True, slots=True)
class StageTime:
    """seconds that a stage took when it ran; reused is whether that was in an earlier run."""

    seconds: float
    reused: bool


@dataclass(frozen=True, slots=True)
class DriveResult:
    """All that is known of a processed drive.

    log_facts       content of ingest's log.json
    model           content of the segmentation's model.json
    odometry        its way, keyframes and calibration; of the points it is the labels, and the submaps, that tell
    observations    how often keyframes saw the odometry's points, their hosts left out
    images          the label images of the keyframes
    labels          of the odometry's points, without their votes
    submaps         read when they are asked for: those of a long drive do not lie in memory side by side
    quality         content of the geo-reference's quality.json
    objects         poles, signs, lights and trunks that the drive saw, each once, in the frame of `submaps`
    times           for each stage, in order
    """

    log: DriveLog
    log_facts: dict[str, Any]
    model: dict[str, Any]
    odometry: OdometryResult
    observations: int
    images: KeyframeLabels
    labels: PointLabels
    geo: GeoReference
    submaps: Sequence[PlacedSubmap]
    quality: dict[str, Any]
    objects: list[MapObject] = field(default_factory=list)
    times: dict[str, StageTime] = field(default_factory=dict)


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
            exports = partial(_exports, context, folder, geoid, write_more, progress(EXPORTS))
            result = in_turn(partial(_stage, followed), progress, settings.threads, exports)
        _publish(stages_dir / "exports", out_dir)
        progress(EXPORTS)(1.0, f"written to {out_dir}")
    return result


def _exports(
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
