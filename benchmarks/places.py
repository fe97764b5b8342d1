"""Makes docs/benchmarks/places.md: `python benchmarks/places.py --cache DIR [--write] [--json FILE] [--cities fleet,fleet-23]`.

Candidates of the place index on simulated drives, which are simulated and processed into DIR where they are not there yet, and the
look-up's time and memory from 1,000 to 100,000 keyframes beside its naive twin. Times are CPU times of one thread.
"""

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pages import DOCS, put_between_marks
from wayloom.logs.simulated_truth import FOLDER, POSES_NAME
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.pipeline.drive import process_drive
from wayloom.places.files import PLACES_FILE, load_places
from wayloom.places.index import Candidate, PlaceIndex, PlaceQuery, Stretch, query_at
from wayloom.places.road import road_m
from wayloom.places.types import PlaceFeatures, Places, PlaceStations
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate

PAGE = DOCS / "benchmarks" / "places.md"
CITIES = ("loop", "hard", "fleet", "fleet-23")
"""Presets, with the seed of another city behind the name."""
SIZE = "quarter"
TOP = 10
REVISIT_M = 12.0
"""A station is a revisit where another pass has a station as near."""
FOUND_M = 20.0
"""A candidate is right where it lies as near: views reach 30 m, and registration needs two thirds of that in common."""
OWN_ROAD_M = 60.0
"""A drive's own road on either side of the query is no revisit."""
ALONG = 0.8
"""Cosine of headings from which a pass counts as of the same or of the opposite direction."""
SIZES = (1_000, 10_000, 100_000)
KEYFRAMES_A_DRIVE = 500
LOOK_UPS = 40
NAIVE_DESCRIPTORS = 8


@dataclass(frozen=True)
class Drive:
    """A processed drive: its city, places and the true poses of its keyframes (K, 3, 4)."""

    name: str
    city: str
    places: Places
    T_enu_cam: NDArray[np.float64]


def processed(city: str, cache: Path) -> list[Drive]:
    """The drives of a city, simulated and processed where they are not there yet."""
    preset, _, seed = city.partition("-")
    output = OutputSettings(size=SIZE, truth=True)
    drives = []
    for log in simulate(preset, cache / city, output, PresetVariant(seed=int(seed) if seed else None)):
        out = cache / "processed" / city / log.name
        process_drive(log, out)
        frame = load_odometry(out / "stages" / "odometry" / ODOMETRY_FILE).keyframes.frame
        truth = np.loadtxt(log / FOLDER / POSES_NAME).reshape(-1, 3, 4)[frame]
        drives.append(Drive(f"{city}/{log.name}", city, load_places(out / "stages" / "places" / PLACES_FILE), truth))
        print(f"{city}/{log.name}: {len(drives[-1].places.stations)} stations", flush=True)
    return drives


def judged(drives: list[Drive]) -> dict[str, dict[str, float]]:
    """Recall and precision of the candidates of every station that is a revisit, by city and direction, without any position."""
    index, by_name = PlaceIndex(), {drive.name: drive for drive in drives}
    for drive in drives:
        index.add(drive.name, drive.places)
    ranks: dict[str, list[int]] = {}
    right: list[float] = []
    for drive in drives:
        road = road_m(drive.places.T_world_keyframe)
        for number, k in enumerate(drive.places.stations.keyframe.tolist()):
            without = Stretch(drive.name, road[k] - OWN_ROAD_M, road[k] + OWN_ROAD_M)
            found = index.candidates(query_at(drive.places, number), TOP, without=without)
            passes = {d for other in drives for d in revisits(drive, k, other)}
            for direction in passes:
                at = [rank for rank, c in enumerate(found) if is_right(drive, k, by_name[c.drive_id], c, direction)]
                ranks.setdefault(f"{drive.city} {direction}", []).append(at[0] if at else TOP)
            if passes:
                right.append(float(np.mean([any(is_right(drive, k, by_name[c.drive_id], c, d) for d in passes) for c in found])))
    rows = {
        name: {"stations": len(r), "first": np.mean(np.array(r) == 0), "top": np.mean(np.array(r) < TOP)}
        for name, r in ranks.items()
    }
    for direction in ("same", "opposite"):
        r = np.concatenate([np.array(r) for name, r in ranks.items() if name.endswith(direction)])
        rows[f"all {direction}"] = {"stations": len(r), "first": np.mean(r == 0), "top": np.mean(r < TOP)}
    rows["precision"] = {"stations": len(right), "first": float("nan"), "top": float(np.mean(right))}
    return {name: {key: float(value) for key, value in row.items()} for name, row in rows.items()}


def revisits(drive: Drive, k: int, other: Drive) -> set[str]:
    """In which directions the other drive, or the drive itself at another time, passes keyframe k."""
    if other.city != drive.city:
        return set()
    rows = other.places.stations.keyframe
    near = np.linalg.norm(other.T_enu_cam[rows, :, 3] - drive.T_enu_cam[k, :, 3], axis=1) < REVISIT_M
    if other is drive:
        road = road_m(drive.places.T_world_keyframe)
        near &= np.abs(road[rows] - road[k]) > OWN_ROAD_M
    cosine = other.T_enu_cam[rows, :, 2] @ drive.T_enu_cam[k, :, 2]
    return {name for name, along in (("same", cosine > ALONG), ("opposite", cosine < -ALONG)) if (near & along).any()}


def is_right(drive: Drive, k: int, other: Drive, found: Candidate, direction: str) -> bool:
    """Whether a candidate is a pass of keyframe k in that direction."""
    T = other.T_enu_cam[found.anchor]
    cosine = float(T[:, 2] @ drive.T_enu_cam[k, :, 2])
    near = np.linalg.norm(T[:, 3] - drive.T_enu_cam[k, :, 3]) < FOUND_M
    return bool(drive.city == other.city and near and (cosine if direction == "same" else -cosine) > ALONG)


def made_drive(pool: list[Drive], seed: int) -> Places:
    """A kilometre with a keyframe in two metres: descriptors of the pool's drives with a fifth of their bits changed, and their
    surroundings, moved at random."""
    rng = np.random.default_rng(seed)
    bits = np.concatenate([d.places.features.bits for d in pool])
    grids = np.concatenate([d.places.stations.grid for d in pool])
    count = 200 * KEYFRAMES_A_DRIVE
    noise = np.packbits(rng.random((count, 256), np.float32) < 0.2, axis=1)
    T = np.tile(np.eye(4), (KEYFRAMES_A_DRIVE, 1, 1))
    T[:, 2, 3] = 2.0 * np.arange(KEYFRAMES_A_DRIVE)
    rows = np.arange(0, KEYFRAMES_A_DRIVE, 5, dtype=np.int32)
    grid = grids[rng.integers(0, len(grids), len(rows))]
    around = np.stack([np.roll(g, rng.integers(-12, 13, 2), axis=(1, 2)) for g in grid])
    none = np.zeros(count, np.float32)
    features = PlaceFeatures(
        np.repeat(np.arange(KEYFRAMES_A_DRIVE, dtype=np.int32), 200), bits[rng.integers(0, len(bits), count)] ^ noise,
        np.zeros((count, 2), np.float32), np.zeros((count, 3), np.float32), none,
    )  # fmt: skip
    like = pool[0].places
    return replace(
        like, T_world_keyframe=T, segment=np.zeros(len(T), np.int32), features=features, stations=PlaceStations(rows, around)
    )


def timed(pool: list[Drive]) -> list[dict[str, float]]:
    """Times and memory at each of SIZES keyframes."""
    index, rows, queries = PlaceIndex(), [], []
    for drives in range(1, SIZES[-1] // KEYFRAMES_A_DRIVE + 1):
        places = made_drive(pool, drives)
        index.add(f"made-{drives}", places)
        if drives <= 2:
            queries += [query_at(places, station) for station in range(0, 100, 100 // (LOOK_UPS // 2))]
        keyframes = drives * KEYFRAMES_A_DRIVE
        if keyframes in SIZES:
            start = time.process_time()
            index.candidates(queries[0], TOP)
            merged = time.process_time() - start
            seconds = [cpu_seconds(index, query) for query in queries]
            naive = naive_seconds(index, queries[0])
            rows.append(
                {
                    "keyframes": keyframes, "median_ms": 1e3 * float(np.median(seconds)), "worst_ms": 1e3 * float(np.max(seconds)),
                    "naive_ms": 1e3 * naive, "bytes": index.nbytes / keyframes, "merge_s": merged,
                }
            )  # fmt: skip
            print(rows[-1], flush=True)
    return rows


def cpu_seconds(index: PlaceIndex, query: PlaceQuery) -> float:
    """Of one look-up."""
    start = time.process_time()
    index.candidates(query, TOP)
    return time.process_time() - start


def naive_seconds(index: PlaceIndex, query: PlaceQuery) -> float:
    """Of the naive twin: every key of the query against every key that is held, by counting the bits in which they differ. Measured
    with a few of the query's descriptors and scaled to all of them."""
    keys = index.bits.tables[0].keys
    some = np.random.default_rng(0).integers(0, 1 << 28, NAIVE_DESCRIPTORS).astype(np.uint32)
    start = time.process_time()
    for key in some:
        np.flatnonzero(np.bitwise_count(keys ^ key) <= 1)
    return (time.process_time() - start) * len(query.bits) * len(index.bits.tables) / NAIVE_DESCRIPTORS


def page(recall: dict[str, dict[str, float]], times: list[dict[str, float]]) -> str:
    """The tables."""
    lines = ["| drives, direction | stations passed again | right first | right in the first ten |", "| --- | --- | --- | --- |"]
    for name, row in recall.items():
        if name != "precision":
            lines.append(f"| {name} | {row['stations']:.0f} | {row['first']:.2f} | {row['top']:.2f} |")
    lines += ["", f"Of the candidates of these stations {recall['precision']['top']:.2f} are right.", ""]
    lines += ["| keyframes | look-up ms, median | worst | naive twin ms | bytes a keyframe | first look-up after all came, s |"]
    lines += ["| --- | --- | --- | --- | --- | --- |"]
    for t in times:
        cells = f"{t['median_ms']:.1f} | {t['worst_ms']:.1f} | {t['naive_ms']:.0f} | {t['bytes']:.0f} | {t['merge_s']:.1f}"
        lines.append(f"| {t['keyframes']:,.0f} | {cells} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="where simulated and processed drives are kept")
    parser.add_argument("--cities", default=",".join(CITIES))
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    drives = [drive for city in options.cities.split(",") for drive in processed(city, options.cache)]
    recall, times = judged(drives), timed(drives)
    text = page(recall, times)
    print(text)
    if options.write:
        put_between_marks(PAGE, "places", text)
    if options.json:
        options.json.write_text(json.dumps({"recall": recall, "times": times}, indent=1) + "\n")


if __name__ == "__main__":
    main()
