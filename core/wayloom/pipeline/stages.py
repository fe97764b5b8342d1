"""The stages of one drive. Each takes paths, leaves one folder, and is not run again while its key is the same.

stage         reads                            leaves (beside stage.json, which says that it is whole)
ingest        the log                          log.json
odometry      the log                          odometry.npz, evidence.npz, report.json
segmentation  the log, odometry                left/, right/ (PNG, named by frame), model.json
labelling     odometry, segmentation           labels.npz
georeference  the log, odometry                georeference.npz, report.json
submaps       the log, odometry, labelling, georeference   index.json and one file a submap

The folders of finished stages lie (or are linked) side by side under their stages' names in `inputs_dir`.
"""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.calibration.rig_file import lens_for_log
from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError, TooFewKeyframesError
from wayloom.geometry.lens import RightLens
from wayloom.georeference.alignment import georeference
from wayloom.georeference.files import load_georeference, save_georeference
from wayloom.labelling.files import load_labels, save_labels
from wayloom.labelling.tcl import label_points, voting_frames
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog
from wayloom.odometry.result.odometry_file import load_odometry, save_odometry
from wayloom.odometry.rig.calibration_file import save_observations
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline import keys
from wayloom.pipeline.exports import cloud, drive_map, write_image
from wayloom.pipeline.ingest import fingerprint, ingest, read_log_file
from wayloom.pipeline.settings import ProcessSettings
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model, locate
from wayloom.segmentation.network import Network
from wayloom.segmentation.providers import resolved_device
from wayloom.segmentation.stage import KeyframeLabels, segment_keyframes
from wayloom.submaps.files import save_submaps
from wayloom.submaps.split import make_submaps

STAGES: Final = ("ingest", "odometry", "segmentation", "labelling", "georeference", "submaps")
ODOMETRY_FILE: Final = "odometry.npz"
EVIDENCE_FILE: Final = "evidence.npz"
LABELS_FILE: Final = "labels.npz"
GEOREFERENCE_FILE: Final = "georeference.npz"
PREVIEW_FILE: Final = "preview.png"
LEAST_KEYFRAMES: Final = 2


@dataclass(frozen=True, slots=True)
class StageCall:
    """What a stage is given. drive_id is the name that the map shall keep for the drive; None takes the log's."""

    log_path: Path
    gnss_path: Path | None
    inputs_dir: Path
    settings: ProcessSettings
    drive_id: str | None = None

    def log(self) -> DriveLog:
        """The drive log, opened anew."""
        return open_log(self.log_path, gnss=self.gnss_path)

    def odometry(self) -> OdometryResult:
        """The tracked drive. Raises TooFewKeyframesError where nothing can be mapped."""
        result = load_odometry(self.inputs_dir / "odometry" / ODOMETRY_FILE)
        if len(result.keyframes) < LEAST_KEYFRAMES:
            raise TooFewKeyframesError(
                f"a map needs at least {LEAST_KEYFRAMES} keyframes, the odometry found {len(result.keyframes)} (frames in the log: "
                f"{len(result.trajectory)}); report.json in the odometry's folder says what was lost and why"
            )
        return result

    def voters_labels(self, odometry: OdometryResult) -> KeyframeLabels:
        """The label images of the frames that vote: the keyframes, or every tracked frame."""
        return KeyframeLabels(self.inputs_dir / "segmentation", voting_frames(odometry, self.settings.labelling))


@dataclass(frozen=True, slots=True)
class Stage:
    """run(call, out_dir, progress); what it reads of other stages; its parameters; the code that makes its result."""

    run: Callable[[StageCall, Path, Progress], None]
    reads: tuple[str, ...]
    parameters: Callable[[ProcessSettings], Mapping[str, Any]]
    rooms: tuple[str, ...]


def run_stage(
    name: str,
    *,
    log_path: Path,
    gnss_path: Path | None,
    inputs_dir: Path,
    out_dir: Path,
    settings: ProcessSettings,
    progress: Progress = silent,
    drive_id: str | None = None,
) -> dict[str, Any]:
    """Run a stage into out_dir, which exists and is empty, and return what its stage.json says (`key`, `digest`, `seconds` …).

    drive_id : which drive the submaps shall name; None takes the log's name
    stage.json is written last: a folder that has it is whole. Raises InputError for a bad log, network or setting and
    StageError where the stages before it left nothing to go on with.
    """
    stage = _stage(name)
    call = StageCall(log_path, gnss_path, inputs_dir, settings, drive_id)
    key = _key(name, call)
    start = time.perf_counter()
    stage.run(call, out_dir, progress)
    said = {
        "stage": name,
        "key": key,
        "digest": keys.digest_of_folder(out_dir),
        "seconds": round(time.perf_counter() - start, 3),
        "code": keys.code_version(stage.rooms),
        "parameters": dict(stage.parameters(settings)),
    }
    (out_dir / keys.STAGE_FILE).write_text(json.dumps(said, indent=1) + "\n")
    return said


def stage_key(
    name: str,
    *,
    log_path: Path,
    gnss_path: Path | None,
    inputs_dir: Path,
    settings: ProcessSettings,
    drive_id: str | None = None,
) -> str:
    """The key that a stage's result has, or would have: a folder whose stage.json says it (`finished_key`) need not be made again.

    Raises StageError where a stage that it reads is not finished, InputError for a bad log, network or setting.
    """
    return _key(name, StageCall(log_path, gnss_path, inputs_dir, settings, drive_id))


def finished_key(folder: Path) -> str | None:
    """The key of the result in this folder; None where there is none, or only part of one."""
    said = keys.read_stage_file(folder)
    return None if said is None else str(said["key"])


def _key(name: str, call: StageCall) -> str:
    stage = _stage(name)
    inputs: dict[str, str] = {}
    for read in stage.reads:
        said = keys.read_stage_file(call.inputs_dir / read)
        if said is None:
            raise StageError(f"{name} needs the result of {read}, which is not in {call.inputs_dir}; run {read} first")
        inputs[read] = said["digest"]
    if name == "ingest":
        inputs["files"] = fingerprint(call.log())
    else:
        inputs |= _log_inputs(name, call)
        if name == "odometry":
            inputs["lens"] = _key_of_lens(lens_of(call.settings, call.log())[0])
    return keys.stage_key(name, inputs, stage.parameters(call.settings), keys.code_version(stage.rooms))


def _stage(name: str) -> Stage:
    if name not in _STAGES:
        raise StageError(f"unknown stage {name!r}; known are {', '.join(STAGES)}")
    return _STAGES[name]


def _log_inputs(name: str, call: StageCall) -> dict[str, str]:
    """The digests of those parts of the log that the stage reads, and the drive's name where it leaves it."""
    said = read_log_file(call.inputs_dir / "ingest")
    inputs = {f"log/{part}": said["digests"][part] for part in _PARTS_OF_LOG.get(name, ())}
    return inputs | ({"drive": call.drive_id or said["name"]} if name == "submaps" else {})


def _ingest(call: StageCall, out_dir: Path, progress: Progress) -> None:
    ingest(call.log(), out_dir, progress)


def _odometry(call: StageCall, out_dir: Path, progress: Progress) -> None:
    log = call.log()
    lens, collector = lens_of(call.settings, log)[0], ObservationCollector(log.rig)
    result = track_calibrated(log, call.settings.odometry, progress, call.settings.threads, lens, (collector,))
    if not np.isfinite(result.trajectory.T_world_cam).all():
        raise StageError("the odometry gave poses that are not finite: please report this drive as a fault of wayloom")
    save_odometry(result, out_dir / ODOMETRY_FILE)
    save_observations(collector.observations(log), out_dir / EVIDENCE_FILE)
    _write_report(out_dir, result.report)


def _key_of_lens(lens: RightLens | None) -> str:
    return keys.sha256_of_json(None if lens is None else lens.values.tolist())


def lens_of(settings: ProcessSettings, log: DriveLog) -> tuple[RightLens | None, tuple[str, ...]]:
    """The lens of the log's rig, None where it is not known, and doubts. Raises CalibrationError for another rig's file."""
    return lens_for_log(settings.rig, log)


def _segmentation(call: StageCall, out_dir: Path, progress: Progress) -> None:
    chosen = call.settings.segmentation
    network = Network(find_model(chosen.model or DEFAULT_MODEL), call.settings.threads, chosen.device)
    segment_keyframes(call.log(), voting_frames(call.odometry(), call.settings.labelling), network, out_dir, progress)


def _labelling(call: StageCall, out_dir: Path, progress: Progress) -> None:
    odometry = call.odometry()
    labels = label_points(odometry, call.voters_labels(odometry), call.settings.labelling, progress)
    save_labels(labels, out_dir / LABELS_FILE)


def _georeference(call: StageCall, out_dir: Path, progress: Progress) -> None:
    settings = call.settings
    geo = georeference(call.log(), call.odometry(), settings.map_frame(), settings.georeference, progress)
    save_georeference(geo, out_dir / GEOREFERENCE_FILE)
    _write_report(out_dir, geo.report)


def _submaps(call: StageCall, out_dir: Path, progress: Progress) -> None:
    labels = load_labels(call.inputs_dir / "labelling" / LABELS_FILE)
    geo = load_georeference(call.inputs_dir / "georeference" / GEOREFERENCE_FILE)
    progress(0.0, "cutting the drive into submaps")
    placed = make_submaps(call.log(), call.odometry(), labels, geo, call.settings.submaps, call.drive_id)
    progress(0.8, f"writing {len(placed)} submaps")
    save_submaps(placed, out_dir)
    write_image(out_dir / PREVIEW_FILE, drive_map(geo, *cloud(placed)))


def _write_report(out_dir: Path, report: Mapping[str, Any]) -> None:
    (out_dir / keys.REPORT_FILE).write_text(json.dumps(report, indent=1) + "\n")


def _model(settings: ProcessSettings) -> dict[str, Any]:
    """The network by content: another file under the same name is another parameter. Raises ModelError."""
    description = find_model(settings.segmentation.model or DEFAULT_MODEL)
    return {
        "description": description.model_dump(mode="json", exclude={"folder"}),
        "sha256": locate(description)[1],
        "device": resolved_device(settings.segmentation.device),
        "between_keyframes": settings.labelling.between_keyframes,
    }


_PARTS_OF_LOG: Final = {"odometry": ("images",), "segmentation": ("images",), "georeference": ("gnss",)}
_COMMON: Final = ("errors.py", "geometry", "config/classes.py", "files", "logs", "pipeline/stages.py")
_STAGES: Final[dict[str, Stage]] = {
    "ingest": Stage(_ingest, (), lambda settings: {}, (*_COMMON, "pipeline/ingest.py")),
    "odometry": Stage(
        _odometry, (), lambda settings: settings.odometry.model_dump(mode="json"), (*_COMMON, "odometry", "calibration")
    ),
    "segmentation": Stage(_segmentation, ("odometry",), _model, (*_COMMON, "segmentation")),
    "labelling": Stage(
        _labelling,
        ("odometry", "segmentation"),
        lambda settings: settings.labelling.model_dump(mode="json"),
        (*_COMMON, "labelling"),
    ),
    "georeference": Stage(
        _georeference,
        ("odometry",),
        lambda settings: {**settings.georeference.model_dump(mode="json"), "map_origin": settings.map_origin},
        (*_COMMON, "georeference", "mapping"),
    ),
    "submaps": Stage(
        _submaps,
        ("odometry", "labelling", "georeference"),
        lambda settings: settings.submaps.model_dump(mode="json"),
        (*_COMMON, "submaps", "tiles/preview.py", "pipeline/exports.py", "pipeline/plane.py"),
    ),
}
