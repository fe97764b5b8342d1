"""Objects measured: poles, signs, lights and trunks of simulated drives against the truth's list.

python benchmarks/objects.py OUT LOG [OUT LOG ...]   OUT of `wayloom process`, LOG simulated with --truth

The stage runs anew on what OUT holds of the stages before it. --write NAME: the tables into docs/benchmarks/objects.md.
"""

import argparse
import json
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pages import DOCS, put_between_marks
from wayloom.evaluation.objects import ObjectScores, TrueThing, score_objects, shown_in, true_things
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight, lonlatheight_from_enu
from wayloom.geometry import se3
from wayloom.georeference.rigid import mean_motion
from wayloom.ground.files import load_sheet, read_index
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import open_truth
from wayloom.objects.fusion import fuse
from wayloom.objects.making import find_objects
from wayloom.objects.settings import ObjectSettings
from wayloom.objects.types import KINDS, LIGHT, POLE, SIGN, MapObject, PlacedSightings
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.places.road import road_m, spaced
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.recording.presets import CITY_ORIGIN
from wayloom.submaps.files import load_submaps

FloatArray = NDArray[np.float64]
PAGE = DOCS / "benchmarks" / "objects.md"
JOINED = 3
"""Drives that must show a thing for the second table."""


@dataclass(frozen=True)
class Drive:
    """What one drive saw, at its own places and at true ones; instances that it shows; CPU ms a frame, images read or not."""

    own: list[PlacedSightings]
    true: list[PlacedSightings]
    frame: MapFrame
    shown: set[int]
    ms_per_frame: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--write")
    options = parser.parse_args()
    pairs = list(zip(options.paths[::2], options.paths[1::2], strict=True))
    drives = [seen_by(out, log) for out, log in pairs]
    things = things_of(pairs)
    text = "\n\n".join([asked(drives, things), one_by_one(drives, things), joined(drives, things), costs(drives)])
    print(text)
    if options.write:
        put_between_marks(PAGE, options.write, text)


def seen_by(out: Path, log_path: Path) -> Drive:
    """Run the stage on one drive."""
    stages, log, truth = out / "stages", open_log(log_path), open_truth(log_path)
    odometry = load_odometry(stages / "odometry" / ODOMETRY_FILE)
    labels, submaps = KeyframeLabels(stages / "segmentation", odometry.keyframes.frame), load_submaps(stages / "submaps")
    sheets = read_index(stages / "ground")

    def sheet_of(submap):
        return load_sheet(stages / "ground", sheets[submap]) if submap in sheets else None

    next(find_objects(log, odometry, labels, submaps[:1], sheet_of))  # compiles the kernels
    start = time.process_time()
    found = list(find_objects(log, odometry, labels, submaps, sheet_of))
    seconds = time.process_time() - start
    own, true = [], []
    for one, placed in zip(found, submaps, strict=True):
        own.append(PlacedSightings(one, placed.T_enu_submap, placed.covariance, log_path.name))
        T = mean_motion(truth.T_enu_cam[placed.submap.keyframe_frame] @ se3.inverse(placed.submap.T_submap_cam))
        true.append(PlacedSightings(one, T, np.zeros((6, 6)), log_path.name))
    chosen = spaced(road_m(odometry.keyframes.T_world_cam), odometry.keyframes.segment, ObjectSettings().spacing_m)
    shown = shown_in(truth, odometry.keyframes.frame[chosen].tolist())
    assert submaps[0].frame is not None
    return Drive(own, true, submaps[0].frame, shown, 1000.0 * seconds / len(odometry.trajectory))


def things_of(pairs: list[tuple[Path, Path]]) -> list[TrueThing]:
    """The true things around all drives, which are of one city."""
    preset = json.loads((pairs[0][1].parent / "simulation.json").read_text())["preset"]
    city: City = build_city(CitySettings(**preset["city"]), Models())
    by_place = {(one.kind, *np.round(one.place, 2).tolist()): one for _, log in pairs for one in true_things(open_truth(log), city)}
    return [by_place[key] for key in sorted(by_place)]


def asked(drives: list[Drive], things: list[TrueThing]) -> str:
    """Goals of the map of all drives at true places, what was measured, and whether it holds."""
    found, counts = fuse([one for drive in drives for one in drive.true]), counts_of(drives)
    kinds = (POLE, SIGN, LIGHT)
    every = [score_objects(found, things, counts, kind) for kind in kinds]
    often = [score_objects(found, things, counts, kind, JOINED) for kind in kinds]
    cm = [100.0 * one.errors for one in often]
    rows = [
        (f"median error, {JOINED} drives: at most 10 cm", [percentile(one, 50) for one in cm], lambda cm: cm <= 10.0, "{:.1f} cm"),
        (f"p95 of errors, {JOINED} drives: at most 20 cm", [percentile(one, 95) for one in cm], lambda cm: cm <= 20.0, "{:.1f} cm"),
        ("precision, 0.3 m: at least 0.95", [ratio(one.close, one.found) for one in every], lambda value: value >= 0.95, "{:.3f}"),
        ("recall, 0.3 m: at least 0.8", [ratio(one.hit, one.shown) for one in every], lambda value: value >= 0.8, "{:.2f}"),
        ("doubles: under 1 %", [100.0 * ratio(one.doubles, one.found) for one in every], lambda value: value < 1.0, "{:.1f} %"),
    ]  # fmt: skip
    lines = [
        ("asked of the joined map, true poses", *(KINDS[kind].replace("_", " ") for kind in kinds)),
        ("---", *["---:"] * len(kinds)),
    ]
    for name, values, holds, form in rows:
        told = [f"{form.format(one)}, {'held' if holds(one) else 'missed'}" if np.isfinite(one) else "–" for one in values]
        lines.append((name, *told))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def percentile(values: FloatArray, q: int) -> float:
    return float(np.percentile(values, q)) if len(values) else np.nan


def ratio(part: int, whole: int) -> float:
    return part / whole if whole else np.nan


def counts_of(drives: list[Drive]) -> dict[int, int]:
    """How many drives show each instance."""
    return dict(Counter(instance for drive in drives for instance in drive.shown))


def one_by_one(drives: list[Drive], things: list[TrueThing]) -> str:
    """Each drive by itself, at true places: what the stage finds."""
    scores = [
        [score_objects(fuse(drive.true), things, dict.fromkeys(drive.shown, 1), kind) for drive in drives]
        for kind in range(len(KINDS))
    ]
    return table("each drive by itself, true poses", [[added(of_kind)] for of_kind in scores], [""])


def joined(drives: list[Drive], things: list[TrueThing]) -> str:
    """All drives fused, at true places and at their own."""
    counts = counts_of(drives)
    places = {
        "true poses": fuse([one for drive in drives for one in drive.true]),
        "own GNSS poses": in_city(fuse([one for drive in drives for one in drive.own]), drives[0].frame),
    }
    rows = [
        [score_objects(found, things, counts, kind, least) for found in places.values() for least in (1, JOINED)]
        for kind in range(len(KINDS))
    ]
    names = [f", {place}, {least} and more drives" for place in places for least in (1, JOINED)]
    return table("joined", rows, names)


def in_city(found: list[MapObject], frame: MapFrame) -> list[MapObject]:
    """The objects in the city's frame; covariances stay, as the frames are turned by less than a degree."""
    places = np.array([one.position for one in found]).reshape(-1, 3)
    of_city = enu_from_lonlatheight(lonlatheight_from_enu(places, frame), CITY_ORIGIN)
    return [replace(one, position=place) for one, place in zip(found, of_city, strict=True)]


def added(scores: list[ObjectScores]) -> ObjectScores:
    """The scores of several drives as one."""
    numbers = [sum(getattr(one, name) for one in scores) for name in ("found", "true", "close", "doubles", "shown", "hit")]
    arrays = [np.concatenate([getattr(one, name) for one in scores]) for name in ("errors", "sigmas", "facing")]
    return ObjectScores(*numbers, *arrays)


def table(title: str, rows: list[list[ObjectScores]], names: list[str]) -> str:
    """Markdown, a row a kind and way of counting."""
    columns = (
        title, "found", "precision, 1 m", "within 0.3 m", "doubles", "shown", "recall, 0.3 m", "error, median, p95",
        "error/sigma, rms, median of squares", "facing, median",
    )  # fmt: skip
    lines = [columns, ("---", *["---:"] * (len(columns) - 1))]
    for kind, of_kind in zip(KINDS, rows, strict=True):
        for name, one in zip(names, of_kind, strict=True):
            counts = (str(one.found), share(one.true, one.found), share(one.close, one.found), str(one.doubles), str(one.shown))
            errors = (share(one.hit, one.shown), centimetres(one.errors), ratios(one.sigmas), degrees(one.facing))
            lines.append((kind.replace("_", " ") + name, *counts, *errors))
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def costs(drives: list[Drive]) -> str:
    told = ", ".join(f"{drive.ms_per_frame:.1f}" for drive in drives)
    return f"CPU of the stage: {told} ms a frame of the log, reading images included."


def share(part: int, whole: int) -> str:
    return f"{part / whole:.2f}" if whole else "–"


def centimetres(errors: FloatArray) -> str:
    return f"{100 * np.median(errors):.1f} cm, {100 * np.percentile(errors, 95):.1f} cm" if len(errors) else "–"


def ratios(sigmas: FloatArray) -> str:
    return f"{np.sqrt(np.mean(sigmas**2)):.2f}, {np.median(sigmas**2):.2f}" if len(sigmas) else "–"


def degrees(angles: FloatArray) -> str:
    return f"{np.degrees(np.median(angles)):.0f}° ({np.mean(angles < np.pi / 2):.0%} front)" if len(angles) else "–"


if __name__ == "__main__":
    sys.exit(main())
