"""One drive on one page: check the log → track → segment → label → geo-reference → submaps → what people read."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wayloom.config.progress import NamedProgress, silent_for_each
from wayloom.files.atomic import write_atomically
from wayloom.georeference.files import load_georeference
from wayloom.georeference.types import GeoReference
from wayloom.labelling.files import load_labels
from wayloom.labelling.types import PointLabels
from wayloom.logs.registry import check_outside, open_log
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import first_matches
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.exports import write_exports
from wayloom.pipeline.folders import discard, new_folders, put_in_place, sole_writer, sweep, whole_folder, writing_to
from wayloom.pipeline.ingest import read_log_file
from wayloom.pipeline.keys import is_undamaged, read_stage_file
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stages import (
    GEOREFERENCE_FILE,
    LABELS_FILE,
    ODOMETRY_FILE,
    STAGES,
    finished_key,
    lens_of,
    run_stage,
    stage_key,
)
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model
from wayloom.segmentation.network import Network
from wayloom.segmentation.stage import KeyframeLabels
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap

STAGES_DIR: Final = "stages"
PRODUCTS_FILE: Final = "products.json"


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
    images          the label images of the keyframes
    times           for each stage, in order
    """

    log: DriveLog
    log_facts: dict[str, Any]
    model: dict[str, Any]
    odometry: OdometryResult
    images: KeyframeLabels
    labels: PointLabels
    geo: GeoReference
    submaps: list[PlacedSubmap]
    times: dict[str, StageTime]


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
    progress : of each stage by its name, and of "exports"
    write_more : called with the result and the folder in which the finished files are gathered (reports use it)
    Raises InputError for a bad log, network or setting, and for an out_dir that cannot be written; a bad log leaves no trace.
    """
    stages_dir = out_dir / STAGES_DIR
    log = open_log(log_path, gnss=gnss_path)
    check_outside(log, out_dir)
    Network(
        find_model(settings.segmentation.model or DEFAULT_MODEL), device=settings.segmentation.device
    )  # one that cannot be used is told now, not after the odometry
    progress("ingest")(0.0, "looking at the first pairs")
    lens_of(settings, log)  # a rig file that cannot be used, too
    first_matches(log, settings.odometry.row_frames)  # a rig that cannot be tracked with is told before anything is made
    with writing_to(out_dir), new_folders(stages_dir), sole_writer(stages_dir):
        sweep(stages_dir)
        times = {name: _stage(name, stages_dir, log_path, gnss_path, settings, progress) for name in STAGES}
        result = _load(log_path, gnss_path, stages_dir, times)
        progress("exports")(0.0, "writing trajectory, cloud and pictures")
        with whole_folder(stages_dir / "exports") as folder:
            write_exports(result.log, result.odometry, result.images, result.geo, result.submaps, folder)
            progress("exports")(0.6, "writing the report")
            write_more(result, folder)
        _publish(stages_dir / "exports", out_dir)
        progress("exports")(1.0, f"written to {out_dir}")
    return result


def _publish(gathered: Path, out_dir: Path) -> None:
    """Move each product into out_dir, report.json last, and remove those of an earlier run that this one does not have."""
    names = sorted((path.name for path in gathered.iterdir()), key=lambda name: (name == "report.json", name))
    listing = gathered.parent / PRODUCTS_FILE
    earlier = json.loads(listing.read_text()) if listing.exists() else []
    write_atomically(listing, json.dumps(sorted({*earlier, *names})).encode())
    for name in set(earlier) - set(names):
        discard(out_dir / Path(name).name)
    for name in names:
        put_in_place(gathered / name, out_dir / name)
    gathered.rmdir()
    write_atomically(listing, json.dumps(names).encode())


def _stage(
    name: str, stages_dir: Path, log_path: Path, gnss_path: Path | None, settings: ProcessSettings, progress: NamedProgress
) -> StageTime:
    """Run a stage, or find that its result is there."""
    key = stage_key(name, log_path=log_path, gnss_path=gnss_path, inputs_dir=stages_dir, settings=settings)
    reused = finished_key(stages_dir / name) == key and is_undamaged(stages_dir / name)
    progress(name)(0.0, "starting")
    if not reused:
        with whole_folder(stages_dir / name) as folder:
            run_stage(
                name,
                log_path=log_path,
                gnss_path=gnss_path,
                inputs_dir=stages_dir,
                out_dir=folder,
                settings=settings,
                progress=progress(name),
            )
    said = read_stage_file(stages_dir / name) or {}
    progress(name)(1.0, "done before" if reused else "done")
    return StageTime(float(said.get("seconds", 0.0)), reused)


def _load(log_path: Path, gnss_path: Path | None, stages_dir: Path, times: dict[str, StageTime]) -> DriveResult:
    odometry = load_odometry(stages_dir / "odometry" / ODOMETRY_FILE)
    return DriveResult(
        log=open_log(log_path, gnss=gnss_path),
        log_facts=read_log_file(stages_dir / "ingest"),
        model=json.loads((stages_dir / "segmentation" / "model.json").read_text()),
        odometry=odometry,
        images=KeyframeLabels(stages_dir / "segmentation", odometry.keyframes.frame),
        labels=load_labels(stages_dir / "labelling" / LABELS_FILE),
        geo=load_georeference(stages_dir / "georeference" / GEOREFERENCE_FILE),
        submaps=load_submaps(stages_dir / "submaps"),
        times=times,
    )
