"""The map's fusion measured: what it costs as drives come, and how true it is on simulated drives.

python benchmarks/stitching.py speed [--drives 7,14,28,56]       made drives: whole map, one more drive, the sums of before
python benchmarks/stitching.py accuracy OUT LOG [OUT LOG ...]    OUT of `wayloom process`, LOG simulated with --truth

--poses true|own|joined: the true ones, those of each drive's own GNSS, or those after registration between the drives, by the city
graph, or, with --places FILE, those that `fleet_map.py --places FILE` left, where the gate of the service admits the drives; all of
them where more are named. Drives without such a place are left out. --name NAME of the drives in the table's mark. Further:
--json FILE, --write (the table of `accuracy` or `speed` into docs/benchmarks/stitching.md).
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "stitching"))

from made_walls import street_submap

from joined_drives import joined
from pages import DOCS, put_between_marks
from wayloom.config.classes import CLASS_ID, MOVING_CLASSES, PERSONS, SKY, VOID
from wayloom.evaluation.true_surfaces import TrueSurfaces, true_surfaces
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import moved_covariance, moved_cross
from wayloom.labelling.files import load_labels
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import FIRST_MOVER, has_truth, open_truth
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.pipeline.drive_quality import QUALITY_FILE, read_quality
from wayloom.simulation.city.city import build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.recording.presets import CITY_ORIGIN
from wayloom.stitching.grid import pack
from wayloom.stitching.layer_names import STATIC
from wayloom.stitching.merge import merge
from wayloom.stitching.points import Box, MapPoints, canonical, map_points
from wayloom.stitching.regions import STATIC_CLASSES, fuse_region, fused_points, regions_of
from wayloom.stitching.settings import MergeSettings
from wayloom.submaps.split import make_submaps
from wayloom.submaps.submap import PlacedSubmap

PAGE = DOCS / "benchmarks" / "stitching.md"
SETTINGS = MergeSettings()
BUILDING = CLASS_ID["building"]
SEEN_M = 0.3
"""A drive saw a place where a sample of what its camera saw lies so near."""
NEAR_M = 1.0
"""A drive measured a place where it has a point so near whose sigma makes planes."""
WALL_M, FEWEST = 2.0, 8
"""A piece of wall, and the points that a drive must have there."""
MANY = 8
"""Drives, from which on not every number of them is merged."""
STREET_M, POINTS = 300.0, 12_000
"""Of a made drive; each street is driven by two."""


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", default="speed", choices=("speed", "accuracy"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--drives", default="7,14,28,56")
    parser.add_argument("--poses", default="true", help="true, own or joined, or several of them with commas between")
    parser.add_argument("--places", type=Path, help="of fleet_map.py, for the joined ones")
    parser.add_argument("--name", default="", help="of the drives in the table's mark")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.what == "speed":
        show("speed", speed([int(n) for n in options.drives.split(",")]), options)
        return
    for poses in options.poses.split(","):
        rows = accuracy(options.paths, poses, options.places)
        show(" ".join(filter(None, ("accuracy", poses, options.name))), rows, options)


def show(name: str, rows: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Print a table, and write it where asked."""
    print(table(rows), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    if options.write:
        put_between_marks(PAGE, name, table(rows))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown."""
    head = list(rows[0])
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    return "\n".join(lines + [f"| {' | '.join(str(row[key]) for key in head)} |" for row in rows]) + "\n"


# Speed


def speed(counts: Sequence[int]) -> list[dict[str, Any]]:
    """Seconds of the whole map, of what one more drive asks for, and of the sums of before."""
    merge(made_drive(0)[:1])  # compiles
    rows = []
    for count in counts:
        placed = [item for drive in range(count) for item in made_drive(drive)]
        points = sum(len(item.submap) for item in placed)
        whole, one, before = (
            seconds(lambda p=placed: merge(p)),  # type: ignore[misc]
            seconds(lambda p=placed, n=count: one_more(p, made_drive(n))),  # type: ignore[misc]
            seconds(lambda p=placed: whole_table(p)),  # type: ignore[misc]
        )
        rows.append(
            {
                "drives": count,
                "points": points,
                "whole map, CPU s": round(whole, 2),
                "µs a point": round(1e6 * whole / points, 1),
                "one more drive, CPU s": round(one, 2),
                "sums over the whole table, CPU s": round(before, 2),
            }
        )
    return rows


def made_drive(number: int) -> list[PlacedSubmap]:
    """Four submaps along the street number // 2."""
    out = []
    for piece in range(4):
        item = street_submap(3 * (4 * number + piece), POINTS // 4, f"drive-{number:03d}", STREET_M / 4)
        item.T_enu_submap[:2, 3] += [100.0 * (number // 2), piece * STREET_M / 4]
        out.append(item)
    return out


def one_more(placed: list[PlacedSubmap], new: list[PlacedSubmap]) -> None:
    """Fuse the regions that a new drive touches; which submaps reach a region is known to a map that is kept."""
    touched = {key for item in new for key in regions_of(item)}
    for item in placed:
        if item.submap.digest not in REACH:
            REACH[item.submap.digest] = regions_of(item)
    for key in sorted(touched):
        fuse_region(key, [item for item in placed if key in REACH[item.submap.digest]] + new)


REACH: dict[str, set[Any]] = {}


def whole_table(placed: list[PlacedSubmap]) -> None:
    """The merge of before: sums of voxels, and every 16 submaps all of them added up into one table."""
    parts: list[tuple[Any, Any]] = []
    for item in placed:
        key, row = np.unique(pack(np.floor(item.points_enu() / 0.1).astype(np.int64)), return_inverse=True)
        sums = np.zeros((len(key), 25), np.int64)
        np.add.at(sums, row, 1)
        parts.append((key, sums))
        if len(parts) == 16 or item is placed[-1]:
            union = np.unique(np.concatenate([key for key, _ in parts]))
            total = np.zeros((len(union), 25), np.int64)
            for key, sums in parts:
                total[np.searchsorted(union, key)] += sums
            parts = [(union, total)]


def seconds(work: Callable[[], object]) -> float:
    """CPU time of the best of two runs."""
    times = []
    for _ in range(2):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


# Accuracy


@dataclass(frozen=True)
class Member:
    """A drive: its submaps, the true class and instance of each of their points by digest, what its camera saw, and where it has
    points sure enough for a plane."""

    placed: list[PlacedSubmap]
    truth: dict[str, tuple[Any, Any]]
    seen: cKDTree
    points: cKDTree


def member_of(out: Path, log_path: Path, poses: str) -> Member:
    """Read a processed drive and its truth, in the city's frame."""
    log, truth, stages = open_log(log_path), open_truth(log_path), out / "stages"
    odometry = load_odometry(stages / "odometry" / "odometry.npz")
    if poses != "own":  # those of the map come later
        sure = np.tile(np.eye(6) * 1e-6, (len(truth), 1, 1))
        geo = GeoReference(CITY_ORIGIN, truth.T_enu_cam.copy(), sure)
    else:
        own = load_georeference(stages / "georeference" / GEOREFERENCE_FILE)
        T = wgs84.T_enu_enu(CITY_ORIGIN, own.frame)
        anchors = replace(own.anchors, cross=moved_cross(T, own.anchors.cross))
        geo = GeoReference(CITY_ORIGIN, T @ own.T_enu_cam, moved_covariance(T, own.covariance), anchors=anchors)
    placed = list(make_submaps(log, odometry, load_labels(stages / "labelling" / "labels.npz"), geo, drive_id=log_path.name))
    camera, points = log.rig.camera, {}
    for item in placed:
        submap = item.submap
        classes, instances = np.zeros(len(submap), np.uint8), np.zeros(len(submap), np.uint16)
        for k, frame in enumerate(submap.keyframe_frame.tolist()):
            rows = np.flatnonzero(submap.keyframe == k)
            uv = camera.project(se3.transform(se3.inverse(submap.T_submap_cam[k]), submap.xyz[rows].astype(np.float64)))
            u, v = np.rint(uv).astype(int).clip(0, [camera.width - 1, camera.height - 1]).T
            classes[rows], instances[rows] = truth.class_id(frame)[v, u], truth.instance(frame)[v, u]
        points[submap.digest] = classes, instances
    seen = cKDTree(truth.surface().points_enu)
    return Member(placed, points, seen, cKDTree(sure_points(placed)))


def sure_points(placed: Sequence[PlacedSubmap]) -> Any:
    """(N, 3) m, with a sigma that makes planes."""
    return np.concatenate([item.points_enu()[item.submap.variance <= SETTINGS.surface_sigma_m**2] for item in placed])


def accuracy(paths: Sequence[Path], poses: str, places: Path | None) -> list[dict[str, Any]]:
    """Each drive alone, and the first two, three, … together; of many the first 2, 4, 8, … and all."""
    both = list(zip(paths[::2], paths[1::2], strict=True))
    if poses == "own":
        both = [(out, log) for out, log in both if has_place(out)]
    members = [member_of(out, log, "own" if poses == "joined" and places is None else poses) for out, log in both]
    if poses == "joined" and places is None:
        found = joined([out for out, _ in both], [member.placed for member in members])
        members = [moved(member, items) for member, items in zip(members, found, strict=True)]
    elif poses == "joined":
        members = in_the_map(members, places)
    count, facades = len(members), facades_of(tuple(sorted({log.parent for log in paths[1::2]})))
    alone = [judged([member], facades, member.placed[0].drive_id) for member in members]
    several = range(2, count + 1) if count <= MANY else sorted({2**k for k in range(1, count.bit_length())} | {count})
    return alone + [judged(members[:n], facades, f"the first {n}") for n in several]


def has_place(out: Path) -> bool:
    """Whether a drive's own GNSS places it."""
    return bool(read_quality(out / "stages" / "georeference" / QUALITY_FILE)["placed"])


def moved(member: Member, placed: list[PlacedSubmap]) -> Member:
    """The drive with its submaps elsewhere."""
    return replace(member, placed=placed, points=cKDTree(sure_points(placed)))


def in_the_map(members: Sequence[Member], places: Path) -> list[Member]:
    """Those of the drives that are in the map, where it has them."""
    out = []
    with np.load(places) as archive:
        for member in members:
            name = member.placed[0].drive_id
            if f"{name}.T" in archive:
                at = zip(member.placed, archive[f"{name}.T"], archive[f"{name}.C"], strict=True)
                out.append(moved(member, [replace(item, T_enu_submap=T, covariance=C) for item, T, C in at]))
    return out


def facades_of(folders: tuple[Path, ...]) -> TrueSurfaces:
    """The true facades along all drives of a simulated city, whose logs lie below one folder or several."""
    settings = json.loads((folders[0] / "simulation.json").read_text())["preset"]["city"]
    logs = [log for folder in folders for log in sorted(folder.iterdir()) if has_truth(log)]
    track = np.concatenate([open_truth(log).T_enu_cam[::5, :3, 3] for log in logs])
    return true_surfaces(build_city(CitySettings(**settings), Models()), track, 70.0, (BUILDING,))


def judged(members: Sequence[Member], facades: TrueSurfaces, name: str) -> dict[str, Any]:
    """Facades and labels of the points before, of the fused map, and of what several drives vote on."""
    items = canonical(item for member in members for item in member.placed)
    truth = {digest: columns for member in members for digest, columns in member.truth.items()}
    points = map_points(items, Box(*(np.full(2, side * 1e6) for side in (-1.0, 1.0, -1.0, 1.0))), SETTINGS)
    kept = [~np.isin(item.submap.label, (*PERSONS, SKY, VOID)) for item in items]
    classes, instances = (
        np.concatenate([truth[item.submap.digest][column][rows] for item, rows in zip(items, kept, strict=True)])
        for column in (0, 1)
    )
    fused, layer = fused_points(points, SETTINGS)
    voxels = merge(items)
    static = layer == STATIC
    row = np.searchsorted(pack(voxels.keys.astype(np.int64)), pack(np.floor(fused.xyz / SETTINGS.voxel_m).astype(np.int64)[static]))
    counts = np.zeros((len(voxels), 256), np.int32)
    np.add.at(counts, (row, classes[static]), 1)
    movers = np.bincount(row, instances[static] >= FIRST_MOVER, len(voxels)) > 0.5 * counts.sum(axis=1)
    before = ~np.isin(points.label, MOVING_CLASSES) & (classes == BUILDING) & (instances < FIRST_MOVER)
    wall = (counts.argmax(axis=1) == BUILDING) & ~movers
    errors, old = facades.distance(voxels.points_enu[wall]), facades.distance(points.xyz[before])
    equal = np.isin(classes[static], STATIC_CLASSES) & (instances[static] < FIRST_MOVER)
    true, own, new = classes[static][equal], points.label[static][equal], voxels.label[row][equal]
    seen = np.sum([member.seen.query(voxels.points_enu, distance_upper_bound=SEEN_M)[0] < SEEN_M for member in members], axis=0)
    near = np.sum([member.points.query(voxels.points_enu, distance_upper_bound=NEAR_M)[0] < NEAR_M for member in members], axis=0)
    shared, many = voxels.drives >= 2, len(members) > 1
    votes = (shared, shared[seen >= 2], shared[(seen >= 2) & (near >= 2)])
    several = [errors[voxels.drives[wall] == n] if n < 3 else errors[voxels.drives[wall] >= n] for n in (1, 2, 3)]
    return {
        "drives": name,
        "points, % published": f"{len(points)}, {100 * static[~np.isin(points.label, MOVING_CLASSES)].mean():.0f}",
        "facade points: median, p95 cm, % > 15 cm, > 50 cm": stated(old),
        "facade voxels: the same": stated(errors),
        "% > 15 cm by 1, 2, 3+ drives": ", ".join(f"{100 * (e > 0.15).mean():.1f}" if len(e) else "–" for e in several),
        "% voxels by 2+ drives; where 2+ saw; where 2+ saw and measured": "; ".join(percent(v) for v in votes) if many else "–",
        "apart on the same wall: median, p95 cm": apart_on_walls(points, before) if many else "–",
        "labels of equal points: own → map, %": f"{100 * (own == true).mean():.2f} → {100 * (new == true).mean():.2f}",
    }  # fmt: skip


def apart_on_walls(points: MapPoints, wall: Any) -> str:
    """How far apart two drives have the same piece of wall: of cubes of WALL_M in which both have FEWEST sure points, the distance
    of the means along the normal of the first one's plane."""
    sure = np.flatnonzero(wall & (points.sigma2 <= SETTINGS.surface_sigma_m**2))
    cell = pack(np.floor(points.xyz[sure] / WALL_M).astype(np.int64))
    order = np.lexsort((points.drive[sure], cell))
    group = np.flatnonzero(np.diff(cell[order], prepend=-1) | np.diff(points.drive[sure][order], prepend=-1))
    pieces = [sure[rows] for rows in np.split(order, group[1:])]
    of_cell: dict[int, list[Any]] = {}
    for rows in pieces:
        if len(rows) >= FEWEST:
            of_cell.setdefault(int(pack(np.floor(points.xyz[rows[:1]] / WALL_M).astype(np.int64))[0]), []).append(points.xyz[rows])
    found = [off for same in of_cell.values() for a, b in combinations(same, 2) if (off := wall_distance(a, b)) is not None]
    return "–" if not found else "{:.1f}, {:.0f}".format(*(100 * np.percentile(found, (50, 95))))


def wall_distance(a: Any, b: Any) -> float | None:
    """m between the means of points a and b (n, 3) along the normal of the plane of a; None where that is no plane."""
    _, spread, axes = np.linalg.svd(a - a.mean(axis=0))
    flat = spread[2] < 0.2 * np.sqrt(len(a)) and spread[2] < 0.5 * spread[1]
    return float(abs(axes[2] @ (b.mean(axis=0) - a.mean(axis=0)))) if flat else None


def percent(hits: Any) -> str:
    """A share, in percent."""
    return f"{100 * hits.mean():.0f}" if len(hits) else "–"


def stated(errors: Any) -> str:
    """Median and 95th percentile in cm, and the shares beyond 15 and 50 cm in percent."""
    median, most = 100 * np.percentile(errors, (50, 95))
    return f"{median:.1f}, {most:.0f}, {100 * (errors > 0.15).mean():.1f}, {100 * (errors > 0.5).mean():.1f}"


if __name__ == "__main__":
    main()
