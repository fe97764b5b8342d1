"""Change in the map measured on simulated drives with truth; tables as docs/benchmarks/change.md has them.

    python benchmarks/change.py changed OUT LOG OUT LOG [--seed N] [--poses true] [--write NAME]
    python benchmarks/change.py least OUT LOG OUT LOG [--seed N] [--poses true] [--write NAME]
    python benchmarks/change.py rates OUT LOG OUT LOG [--seed N] [--write NAME]
    python benchmarks/change.py still OUT LOG [OUT LOG ...] [--poses true] [--write NAME]
    python benchmarks/change.py looks OUT LOG [OUT LOG ...] [--write NAME]

OUT is what `wayloom process LOG --gnss LOG/gnss.csv` left of a drive, LOG the drive as simulated with truth. `changed` takes one
drive of the city before its changes and one after them, first as they are, then with their days exchanged: what has gone one way is
new the other way. `least` says of two such drives what would be listed if a change needed more points, both ways together. `rates`
counts the words of the looks of each of two such drives on things that the other has, those that stand and those that went. `still`
takes drives of one unchanged city, each on its own day. `--poses true` places the drives by their true poses with 2 cm of sigma, so
that poses excuse nothing. The looks are made from the images; `looks` says what that costs.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pages import DOCS, put_between_marks
from wayloom.config.classes import CLASS_ID
from wayloom.dense.extraction import make_looks
from wayloom.dense.files import encode_looks
from wayloom.dense.types import BUILT, GREEN, MOVING, THIN, Looks
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.georeference.rigid import mean_motion
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.logs.registry import open_log
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.simulation.city.city import build_city
from wayloom.simulation.city.objects import Area
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.recording.presets import CITY_ORIGIN, PRESETS
from wayloom.stitching.change_types import Change
from wayloom.stitching.layer_names import PARKED, STATIC
from wayloom.stitching.placed_looks import PlacedLooks, canonical_looks, place_looks
from wayloom.stitching.points import Box, canonical, map_points
from wayloom.stitching.region_grid import RegionMap
from wayloom.stitching.regions import fuse_region, fused_points, regions_of
from wayloom.stitching.settings import ChangeSettings, MergeSettings
from wayloom.stitching.sightings import Sightings, sightings_of
from wayloom.stitching.things import Things, find_things, kinds_of
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap

PAGE = DOCS / "benchmarks" / "change.md"
DAY_NS = 86_400 * 10**9
BESIDE_M = 15.0
"""Changes so near the way are asked for: the posts and cars at its sides. What is called changed is held against all changes."""
AT_M = {THIN: 0.8, MOVING: 2.5}
"""A thing's points lie so near the foot that the truth gives it."""
NAMES = {THIN: "posts and signs", MOVING: "vehicles"}
WORDS_OF = {**NAMES, GREEN: "hedges and trees", BUILT: "walls"}
STANDS_M = 4.0
"""What is so far from all changes of its kind stands."""
POSE_SIGMA_M = 0.02


@dataclass(frozen=True)
class Drive:
    """A processed drive in the map's frame, with its looks; CPU seconds that they took, frames and metres driven."""

    submaps: list[PlacedSubmap]
    looks: list[PlacedLooks]
    all_looks: Looks
    look_s: float
    frames: int
    road_m: float


@dataclass(frozen=True)
class TrueThing:
    """A place whose thing was removed or added: kind as in `wayloom.dense.types`, foot (3,) m in the map's frame."""

    kind: int
    foot: np.ndarray


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("changed", "least", "rates", "still", "looks"))
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--poses", choices=("own", "true"), default="own")
    parser.add_argument("--write", metavar="NAME")
    options = parser.parse_args()
    drives = [loaded(out, log, f"drive-{i}", options.poses) for i, (out, log) in enumerate(pairs(options.paths))]
    of_two = {"changed": changed, "least": least, "rates": rates}
    if options.what in of_two:
        rows = of_two[options.what](drives, options.seed)
    else:
        rows = still(drives) if options.what == "still" else costs(drives)
    head = list(rows[0])
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    text = "\n".join(lines + [f"| {' | '.join(str(row[key]) for key in head)} |" for row in rows]) + "\n"
    print(text)
    if options.write:
        put_between_marks(PAGE, options.write, text)


def pairs(paths: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
    """OUT and LOG of each drive."""
    return zip(paths[::2], paths[1::2], strict=True)


def loaded(out: Path, log_path: Path, drive_id: str, poses: str) -> Drive:
    """A drive with its looks."""
    log, odometry = open_log(log_path), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    images = KeyframeLabels(out / "stages" / "segmentation", odometry.keyframes.frame)
    make_looks(log, replace(odometry, keyframes=_first(odometry.keyframes)), images)  # compiles
    start = time.process_time()
    looks = make_looks(log, odometry, images)
    look_s = time.process_time() - start
    submaps = [replace(item, drive_id=drive_id) for item in load_submaps(out / "stages" / "submaps")]
    if poses == "true":
        truth = np.tile(np.eye(4), (len(log.t_ns), 1, 1))
        truth[:, :3] = np.loadtxt(log_path / "truth" / "poses_enu.txt").reshape(-1, 3, 4)
        submaps = [by_truth(item, truth) for item in submaps]
    road = sum(item.submap.length_m for item in submaps)
    return Drive(submaps, [place_looks(item, looks) for item in submaps], looks, look_s, len(log.t_ns), road)


def _first(keyframes: Any) -> Any:
    return replace(keyframes, **{name: getattr(keyframes, name)[:1] for name in keyframes.__slots__})


def by_truth(item: PlacedSubmap, T_city_cam: np.ndarray) -> PlacedSubmap:
    """The submap where its keyframes truly were, all of it uncertain by POSE_SIGMA_M."""
    T_frame_city = wgs84.T_enu_enu(item.frame, CITY_ORIGIN)
    T = mean_motion(T_frame_city @ T_city_cam[item.submap.keyframe_frame] @ se3.inverse(item.submap.T_submap_cam))
    here, local = np.eye(4), np.zeros((6, 6))
    here[:3, 3], local[:3, :3] = T[:3, 3], POSE_SIGMA_M**2 * np.eye(3)
    return replace(item, T_enu_submap=T, covariance=moved_covariance(here, local[None])[0])


def on_day(drive: Drive, day: int) -> tuple[list[PlacedSubmap], list[PlacedLooks]]:
    """The drive as if it had been driven on that day: simulated drives share theirs."""
    submaps = [
        replace(
            item,
            submap=replace(
                item.submap,
                seen_ns=item.submap.seen_ns + day * DAY_NS,
                keyframe_t_ns=item.submap.keyframe_t_ns + day * DAY_NS,
            ),
        )
        for item in drive.submaps
    ]
    return submaps, [place_looks(item, drive.all_looks) for item in submaps]


def mapped(
    drives: Sequence[Drive], days: Sequence[int], with_looks: bool = True, settings: MergeSettings = MergeSettings()
) -> list[RegionMap]:
    """The regions of a map of these drives."""
    placed = [on_day(drive, day) for drive, day in zip(drives, days, strict=True)]
    submaps, looks = [item for own, _ in placed for item in own], [item for _, own in placed for item in own]
    keys = sorted(set().union(*(regions_of(item) for item in submaps)))
    return [fuse_region(key, submaps, settings, looks=looks if with_looks else ()) for key in keys]


# Changed cities


def least(drives: Sequence[Drive], seed: int | None) -> list[dict[str, Any]]:
    """A row for each number of points that a change might need."""
    return [_with_least(drives, seed, points) for points in (1, 2, 3, 4)]


def _with_least(drives: Sequence[Drive], seed: int | None, points: int) -> dict[str, Any]:
    settings = MergeSettings(change=ChangeSettings(listed_points=points))
    rows = changed(drives, seed, settings)
    listed = sum(len(one.changes) for days in ((0, 1), (1, 0)) for one in mapped(drives, days, settings=settings))
    out = {"points, at least": points, "listed": listed, "wrong": sum(row["called so falsely"] for row in rows)}
    for name in NAMES.values():
        own = [row for row in rows if row["things"].endswith(name)]
        out[f"{name} found"] = f"{sum(row['found'] for row in own)} of {sum(row['with points in the map'] for row in own)}"
    return out


def changed(drives: Sequence[Drive], seed: int | None, settings: MergeSettings = MergeSettings()) -> list[dict[str, Any]]:
    """A row for each direction of time and kind of thing."""
    before, after = (mapped([drive], [0], with_looks=False) for drive in drives)
    removed, added = (true_things(drives, seed, what) for what in ("removed", "added"))
    all_removed, all_added = (true_things(drives, seed, what, np.inf) for what in ("removed", "added"))
    rows = []
    for forward in (True, False):
        regions = mapped(drives, (0, 1) if forward else (1, 0), settings=settings)
        found = [change for region in regions for change in region.changes]
        # What was removed is gone one way and new the other way; so is what was added.
        truth = {"gone": removed if forward else added, "new": added if forward else removed}
        anywhere = {"gone": all_removed if forward else all_added, "new": all_added if forward else all_removed}
        owner = {"gone": before if forward else after, "new": after if forward else before}
        replaced = {"gone": added if forward else removed, "new": removed if forward else added}
        for kind in ("gone", "new"):
            for bit, name in NAMES.items():
                true = [one for one in truth[kind] if one.kind == bit and not near(one, replaced[kind])]
                seen = [one for one in true if has_points(one, owner[kind])]
                said = [one for one in found if one.kind == kind and bit == kind_of(one)]
                false = [one for one in said if not any(is_at(one, thing) for thing in anywhere[kind] if thing.kind == bit)]
                rows.append(
                    {
                        "days": "as driven" if forward else "exchanged",
                        "things": f"{kind}: {name}",
                        "true, beside the way": len(true),
                        "with points in the map": len(seen),
                        "found": sum(any(is_at(change, one) for change in said) for one in seen),
                        "called so falsely": len(false),
                    }
                )
        others = [one for one in found if kind_of(one) not in NAMES and not any(is_at(one, thing) for thing in anywhere[one.kind])]
        rows.append(
            {
                "days": rows[-1]["days"], "things": "all else", "true, beside the way": 0, "with points in the map": "–",
                "found": "–", "called so falsely": len(others),
            }
        )  # fmt: skip
    return rows


def kind_of(change: Change) -> int:
    """Bit of what a change is taken for; a post that went may be taken for a piece of a wall."""
    return int(kinds_of(np.array([change.label], np.uint8))[0])


def true_things(drives: Sequence[Drive], seed: int | None, what: str, beside_m: float = BESIDE_M) -> list[TrueThing]:
    """The places so near the way whose thing was removed or added; a post and its sign are one."""
    frame = drives[0].submaps[0].frame
    T = wgs84.T_enu_enu(frame, CITY_ORIGIN)
    track = np.concatenate([item.track_enu() for drive in drives for item in drive.submaps])
    in_city = se3.transform(se3.inverse(T), track)
    area = Area(*(tuple(corner) for corner in (in_city[:, :2].min(axis=0) - 40.0, in_city[:, :2].max(axis=0) + 40.0)))
    city = PRESETS["changed"].city
    city = city if seed is None else city.model_copy(update={"seed": seed})
    found: list[TrueThing] = []
    for one in build_city(city, Models()).changes(area):
        thing = TrueThing(int(kinds_of(np.array([one.class_id], np.uint8))[0]), se3.transform(T, one.foot[None])[0])
        beside = np.linalg.norm(track[:, :2] - thing.foot[:2], axis=1).min() < beside_m
        if one.what == what and beside and thing.kind in AT_M and not near(thing, found):
            found.append(thing)
    return found


def near(thing: TrueThing, others: Sequence[TrueThing]) -> bool:
    """Whether one of the same kind stands at the same place."""
    return any(one.kind == thing.kind and distance(one.foot, thing.foot) < AT_M[thing.kind] for one in others)


def distance(one: Any, other: Any) -> float:
    """m, over ground."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))


def is_at(change: Change, thing: TrueThing) -> bool:
    """Whether a change is that of a true thing."""
    return distance(change.position_enu, thing.foot) < AT_M[thing.kind]


def has_points(thing: TrueThing, regions: Sequence[RegionMap]) -> bool:
    """Whether a map publishes or keeps as parked a point of the thing."""
    for region in regions:
        for layer in ("static", "parked"):
            voxels = region.layers[layer]
            at = np.hypot(*(voxels.points_enu[:, :2] - thing.foot[:2]).T) < AT_M[thing.kind]
            if (at & (kinds_of(voxels.label) == thing.kind)).any():
                return True
    return False


# What a look's word is worth


def rates(drives: Sequence[Drive], seed: int | None) -> list[dict[str, Any]]:
    """A row for each kind: words of the looks of one drive on things that only the other has, and that this one sees well itself.

    A thing went (or came) when the truth says so at its place, and stands when nothing of its kind changed within STANDS_M of it.
    """
    things, xyz, own, sights = judged_things(drives)
    truth = [true_things(drives, seed, what, np.inf) for what in ("removed", "added")]
    counts = {(kind, went): np.zeros(3, np.int64) for kind in WORDS_OF for went in (True, False)}
    for mine in (0, 1):
        other, words = 1 - mine, np.stack([sights.seen, sights.bare, sights.through])
        plain = (own[mine] > 0) & (words[0, mine] >= 4) & (words[2, mine] <= 0.25 * words[0, mine])
        for thing in np.flatnonzero(plain & np.isin(things.kind, list(WORDS_OF))):
            kind, at = int(things.kind[thing]), xyz[things.start[thing] : things.start[thing + 1]].mean(axis=0)
            away = min((distance(at, one.foot) for one in truth[mine] if one.kind == kind), default=np.inf)
            others = min((distance(at, one.foot) for one in truth[other] if one.kind == kind), default=np.inf)
            if away < AT_M.get(kind, 0.0) and others > STANDS_M and own[other, thing] == 0:
                counts[kind, True] += words[:, other, thing]
            elif min(away, others) > STANDS_M:
                counts[kind, False] += words[:, other, thing]
    return [
        {
            "things": f"{name}, {'went' if went else 'stand'}",
            "looks": int(counts[kind, went].sum()),
            **{word: shown(counts[kind, went], place) for place, word in enumerate(("see it, %", "bare, %", "see through, %"))},
        }
        for kind, name in WORDS_OF.items()
        for went in (False, True)
        if counts[kind, went].any()
    ]


def shown(counts: np.ndarray, place: int) -> str:
    """Share of one word, %."""
    return f"{100.0 * counts[place] / counts.sum():.1f}"


def judged_things(drives: Sequence[Drive]) -> tuple[Things, np.ndarray, np.ndarray, Sightings]:
    """Things of all drives, their points' places, how many points (D, T) each drive has of them, and what its looks say."""
    placed = [on_day(drive, day) for day, drive in enumerate(drives)]
    settings, everywhere = MergeSettings(), np.full(2, 1e6)
    items = canonical([item for own, _ in placed for item in own])
    looks = canonical_looks([item for _, own in placed for item in own], -everywhere, everywhere, 0.0)
    points = map_points(items, Box(-everywhere, everywhere, -everywhere, everywhere), settings)
    fused, layer = fused_points(points, settings)
    rows = np.flatnonzero((layer == STATIC) | (layer == PARKED))
    things = find_things(fused.xyz, points.label, rows, settings.change.link_m, settings.change.thing_m)
    own = np.zeros((len(drives), len(things)), np.int64)
    np.add.at(own, (points.drive[things.rows], things.thing), 1)
    return things, fused.xyz[things.rows], own, sightings_of(things, points, fused, looks, settings.change)


# Unchanged cities


def still(drives: Sequence[Drive]) -> list[dict[str, Any]]:
    """One row: what an unchanged city loses, in the drives' order and in the opposite one."""
    rows = []
    for days in (range(len(drives)), range(len(drives))[::-1]):
        before = mapped(drives, list(days), with_looks=False)
        start = time.process_time()
        after = mapped(drives, list(days))
        seconds = time.process_time() - start
        voxels = {name: [sum(len(one.layers[name]) for one in regions) for regions in (before, after)] for name in before[0].layers}
        lost = {name: voxels[name][0] - voxels[name][1] for name in ("static", "parked")}
        found = [change for region in after for change in region.changes]
        rows.append(
            {
                "drives": len(drives),
                "order": "as given" if days[0] == 0 else "opposite",
                "static voxels": voxels["static"][0],
                "lost, %": f"{100.0 * lost['static'] / voxels['static'][0]:.3f}",
                "static things gone, new": ", ".join(
                    str(sum(one.kind == kind and one.label < CLASS_ID["person"] for one in found)) for kind in ("gone", "new")
                ),
                "parked voxels": voxels["parked"][0],
                "lost": lost["parked"],
                "merge, CPU s a km": f"{seconds / sum(drive.road_m for drive in drives) * 1e3:.2f}",
            }
        )
    return rows


# Looks


def costs(drives: Sequence[Drive]) -> list[dict[str, Any]]:
    """What looks cost, a row for each drive."""
    rows = []
    for drive in drives:
        looks, size = drive.all_looks, len(encode_looks(drive.all_looks))
        rows.append(
            {
                "look, px": f"{looks.camera.width} × {looks.camera.height}",
                "looks": len(looks),
                "road, m": round(drive.road_m),
                "kB a look": round(size / len(looks) / 1e3, 1),
                "MB a km": round(size / drive.road_m / 1e3, 1),
                "CPU ms a frame driven": round(1e3 * drive.look_s / drive.frames, 1),
                "CPU s a km": round(1e3 * drive.look_s / drive.road_m, 1),
                "patches that are sure, %": round(100.0 * float((looks.near > 0).mean())),
            }
        )
    return rows


if __name__ == "__main__":
    main()
