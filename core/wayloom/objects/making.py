"""Object sightings of a drive, one submap after the other: views → measurements → tracks → things with evidence."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import Each
from wayloom.geometry import se3
from wayloom.ground.sheet import GroundSheet
from wayloom.logs.types import DriveLog
from wayloom.objects.bars import bars, posts
from wayloom.objects.evidence import Facts, facts_of, unseen_views
from wayloom.objects.faces import faces
from wayloom.objects.ground_height import GroundHeight
from wayloom.objects.looking import LookedRaster
from wayloom.objects.measurements import Measurements, joined
from wayloom.objects.odds import odds_of
from wayloom.objects.settings import ObjectSettings
from wayloom.objects.tracks import Track, tracks_of
from wayloom.objects.triangulation import Cameras, cameras_of
from wayloom.objects.types import LIGHT, POLE, SIGN, STANDING, TRUNK, ObjectSightings
from wayloom.objects.view import ObjectView, view_of
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.road import road_m, spaced
from wayloom.places.stereo_pair import LeftLabels, read_pair, right_rectifier
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]


def find_objects(
    log: DriveLog,
    odometry: OdometryResult,
    labels: LeftLabels,
    submaps: Sequence[PlacedSubmap],
    sheet_of: Callable[[str], GroundSheet | None],
    settings: ObjectSettings = ObjectSettings(),
    progress: Progress = silent,
    threads: int = 1,
) -> Iterator[ObjectSightings]:
    """The sightings along each submap, in the order of the road; so many threads read a submap's images.

    sheet_of : the ground sheet of a submap's digest, None where it has none
    Raises StageError where an image's labels are missing, LogError where an image cannot be read.
    """
    chosen = spaced(road_m(odometry.keyframes.T_world_cam), odometry.keyframes.segment, settings.spacing_m)

    with one_opencv_thread(), ThreadPoolExecutor(threads) as pool:
        for number, placed in enumerate(submaps, 1):
            views = read_views(log, odometry, labels, placed, chosen, pool.map if threads > 1 else map)
            found = sightings_of(views, placed, sheet_of(placed.submap.digest), settings)
            progress(number / len(submaps), f"objects of {number} of {len(submaps)} submaps")
            yield found


def level_frame(placed: PlacedSubmap) -> FloatArray:
    """T_submap_level (4, 4): the submap's origin, z up and x east as its pose has it; that of its ground sheet."""
    return se3.from_rotation_translation(placed.T_enu_submap[:3, :3].T, np.zeros(3))


def read_views(
    log: DriveLog, odometry: OdometryResult, labels: LeftLabels, placed: PlacedSubmap, chosen: NDArray[np.bool_], each: Each = map
) -> list[ObjectView]:
    """The views of the chosen (K,) keyframes of a submap, in its level frame."""
    rectifier, T_level_submap = right_rectifier(odometry), se3.inverse(level_frame(placed))
    rows = np.searchsorted(odometry.keyframes.frame, placed.submap.keyframe_frame)

    def see(at: int) -> ObjectView:
        row = int(rows[at])
        pair = read_pair(log, int(odometry.keyframes.frame[row]), labels.left(row), rectifier)
        T_level_cam = T_level_submap @ placed.submap.T_submap_cam[at]
        return view_of(pair, odometry.rig, odometry.disparity_bias_px, T_level_cam, int(placed.submap.keyframe_t_ns[at]))

    with one_opencv_thread():
        return list(each(see, np.flatnonzero(chosen[rows]).tolist()))


def sightings_of(
    views: list[ObjectView], placed: PlacedSubmap, sheet: GroundSheet | None, settings: ObjectSettings
) -> ObjectSightings:
    """What the views of a submap show."""
    T_submap_level = level_frame(placed)
    cameras_xy = np.array([view.T_level_cam[:2, 3] for view in views]).reshape(-1, 2)
    looked = LookedRaster(cameras_xy if len(views) else np.zeros((1, 2)), settings.reach_m)
    for number, view in enumerate(views):
        looked.add(view, number)
    things = tracks_with_facts(views, sheet, settings) if views else []
    rows = [_row(one, facts, seen, cameras, views, ground) for one, facts, seen, cameras, ground in things]
    R = T_submap_level[:3, :3]
    place = np.array([row["place"] for row in rows]).reshape(-1, 3)
    covariance = np.array([row["covariance"] for row in rows]).reshape(-1, 3, 3)
    facing = np.array([row["facing"] for row in rows]).reshape(-1, 3)
    plain = {
        name: np.array([row[name] for row in rows], np.float32)
        for name in ("bottom_m", "top_m", "width_m", "facing_sigma", "evidence_for", "evidence_against")
    }
    return ObjectSightings(
        submap=placed.submap.digest,
        T_submap_level=T_submap_level,
        corner=looked.corner.astype(np.int32),
        looked=looked.looked,
        kind=np.array([one.kind for one, *_ in things], np.uint8),
        position=se3.transform(T_submap_level, place).astype(np.float32),
        covariance=(R @ covariance @ R.T).astype(np.float32),
        facing=(facing @ R.T).astype(np.float32),
        looks=np.array([facts.looks for _, facts, *_ in things], np.uint16),
        first_ns=np.array([row["first_ns"] for row in rows], np.int64),
        last_ns=np.array([row["last_ns"] for row in rows], np.int64),
        **plain,
    )


def measure(views: list[ObjectView], settings: ObjectSettings) -> Measurements:
    """What each view shows by itself."""
    parts = []
    for number, view in enumerate(views):
        carried = joined([faces(view, number, kind, settings.reach_m) for kind in (SIGN, LIGHT)])
        standing = [bars(view, number, kind, settings.reach_m) for kind in (POLE, TRUNK)]
        parts += [carried, *standing, posts(view, carried, number)]
    return joined(parts)


def tracks_with_facts(
    views: list[ObjectView], sheet: GroundSheet | None, settings: ObjectSettings
) -> list[tuple[Track, Facts, Measurements, Cameras, float]]:
    """The tracks of all views, what the views say of each, and the height of the ground under it."""
    seen, cameras, heights = measure(views, settings), cameras_of(views), GroundHeight(sheet)
    standing = np.isin(seen.kind, STANDING) & ~seen.cut_low
    feet = float(np.median(seen.low[standing])) if standing.any() else np.nan
    out = []
    tracks = tracks_of(seen, cameras, settings.least_looks)
    for track in tracks:
        ground = heights.at(track.place[:2])
        if np.isnan(ground):
            ground = float(np.median(seen.low[track.rows])) if track.kind in STANDING else feet
        unseen = unseen_views(track, seen, views, cameras, settings.reach_m)
        out.append((track, facts_of(track, seen, unseen, cameras, ground, tracks), seen, cameras, ground))
    return out


def _row(
    track: Track, facts: Facts, seen: Measurements, cameras: Cameras, views: list[ObjectView], ground: float
) -> dict[str, Any]:
    """A thing's columns, in the level frame."""
    own = seen.take(track.rows)
    low, high = own.low[~own.cut_low], own.high[~own.cut_high]
    bottom = float(np.median(low)) if len(low) else float(own.low.min())
    top = float(np.median(high)) if len(high) else float(own.high.max())
    place, covariance = track.place.copy(), track.covariance.copy()
    base = bottom if np.isnan(ground) else ground
    if track.kind == LIGHT:
        away = (place - cameras.centre[own.view]).mean(axis=0) * np.array([1.0, 1.0, 0.0])
        place += LIGHT_M * away / np.linalg.norm(away)
        covariance += LIGHT_SIGMA_M**2 * np.diag([1.0, 1.0, 0.0])
    if track.kind in STANDING:
        place[2], covariance[2, 2] = base, GROUND_SIGMA_M**2
        bottom = base
    facing, sigma = facing_of(track, own, cameras) if track.kind == SIGN else (np.full(3, np.nan), np.nan)
    odds_for, odds_against = odds_of(track.kind, facts)
    return {
        "place": place, "covariance": covariance, "bottom_m": bottom - base, "top_m": top - base,
        "width_m": np.median(own.width), "facing": facing, "facing_sigma": sigma, "evidence_for": odds_for,
        "evidence_against": odds_against, "first_ns": min(views[k].t_ns for k in own.view),
        "last_ns": max(views[k].t_ns for k in own.view),
    }  # fmt: skip


GROUND_SIGMA_M: Final = 0.04
BACK_STRIPE: Final = 0.09
"""How bright a stripe is that a post makes on a sign's back: brighter than on 19 of 20 faces, fainter than on 9 of 10 backs."""
LIGHT_M, LIGHT_SIGMA_M = 0.25, 0.06
"""What is matched of a light are its visors: its head's middle lies so far behind them."""


def facing_of(track: Track, own: Measurements, cameras: Cameras) -> tuple[FloatArray, float]:
    """Direction (3,), level, in which a face looks, and its sigma, rad; NaN where it is not known.

    It is towards the cameras, but where a post stands before the face: those see its back.

    A slope s of the disparity along the columns gives the normal (s fx, 0, 1 - s u') of an upright face, u' the column from the
    principal point: d = d0 (1 + s (u - u0)).
    """
    known = np.isfinite(own.slope)
    if not known.any():
        return np.full(3, np.nan), np.nan
    fx, _, cx, _ = cameras.numbers
    s, u = own.slope[known], own.uvd[known, 0] - cx
    normal = np.column_stack([s * fx, np.zeros(len(s)), 1.0 - s * u])
    level = np.einsum("nij,nj->ni", cameras.R[own.view[known]], -normal)
    angle = np.arctan2(level[:, 1], level[:, 0])
    sigma = own.slope_sigma[known] * fx
    weight = 1.0 / (sigma**2 + 0.05**2)
    for _ in range(4):
        mean = np.arctan2((weight * np.sin(angle)).sum(), (weight * np.cos(angle)).sum())
        off = (angle - mean + np.pi) % (2.0 * np.pi) - np.pi
        weight = 1.0 / (sigma**2 + 0.05**2 + off**2)
    told = own.stripe[np.isfinite(own.stripe)]
    if len(told) and told.mean() > BACK_STRIPE:
        mean += np.pi
    return np.array([np.cos(mean), np.sin(mean), 0.0]), float(np.hypot(np.sqrt(3.0 / weight.sum()), 0.03))
