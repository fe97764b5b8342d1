"""Points of the submaps around a region, in canonical order, with their uncertainties."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import MOVING_CLASSES, PERSONS, SKY, VOID
from wayloom.errors import StageError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.stitching.grid import KEY_LIMITS
from wayloom.stitching.settings import MergeSettings
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
VEHICLES: Final = tuple(c for c in MOVING_CLASSES if c not in PERSONS)
VOTE_STEPS: Final = 65_536.0


@dataclass(frozen=True, slots=True)
class MapPoints:
    """P points of static things and vehicles in the order of drive, digest and row, V votes.

    xyz          (P, 3) m in the map's frame
    sigma2       (P,) m^2 along its ray; across2 (P,) m^2 across it
    ray          (P, 3) unit, from the host's camera
    common       (P, 3, 3) m^2: what the pose of its submap adds
    label        (P,) uint8; grey (P,) uint8 in the host image; seen_ns (P,) int64; drive (P,) row of drive_ids
    vote_start   (P + 1,) int64; vote_class (V,) uint8; vote_weight (V,) int64 in 1 / VOTE_STEPS per metre, at least one; a point
                 without votes has one step for its label
    drive_ids    sorted
    left_out     how many points of the box are none of these, by reason
    """

    xyz: FloatArray
    sigma2: FloatArray
    across2: FloatArray
    ray: FloatArray
    common: FloatArray
    label: NDArray[np.uint8]
    grey: NDArray[np.uint8]
    seen_ns: IntArray
    drive: IntArray
    vote_start: IntArray
    vote_class: NDArray[np.uint8]
    vote_weight: IntArray
    drive_ids: tuple[str, ...]
    left_out: dict[str, int]

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True, slots=True)
class Box:
    """Of the map's frame, m: low (2,) to high (2,) east and north; core_low, core_high (2,) where points left out are counted."""

    low: FloatArray
    high: FloatArray
    core_low: FloatArray
    core_high: FloatArray


def canonical(placed: Iterable[PlacedSubmap]) -> list[PlacedSubmap]:
    """Each submap of each drive once, by drive and digest.

    Raises StageError when the submaps are of different frames, or of several drives without one.
    """
    items = {(item.drive_id, item.submap.digest): item for item in placed}
    in_order = [items[name] for name in sorted(items)]
    for item in in_order[1:]:
        first = in_order[0]
        if item.frame != first.frame:
            raise StageError(
                f"drive {item.drive_id} lies in the frame {item.frame}, the others in {first.frame}: "
                "geo-reference them in one frame"
            )
        if item.frame is None and item.drive_id != first.drive_id:
            raise StageError(f"drive {item.drive_id} has no GNSS, so it has no place beside other drives: merge it alone")
    return in_order


def frame_of(placed: Sequence[PlacedSubmap]) -> MapFrame | None:
    """The frame of the submaps; None also where there are none."""
    return placed[0].frame if placed else None


def map_points(placed: Sequence[PlacedSubmap], box: Box, settings: MergeSettings) -> MapPoints:
    """The points of canonical submaps within a box. Raises StageError where one lies beyond the grid."""
    drive_ids = tuple(sorted({item.drive_id for item in placed}))
    left_out = {"persons": 0, "sky": 0, "void": 0}
    parts = [_points_of(item, drive_ids.index(item.drive_id), box, settings, left_out) for item in placed]
    columns: list[Any] = [np.concatenate(column) for column in zip(_none(), *parts, strict=True)]
    *per_point, length, vote_class, vote_weight = columns
    xyz, sigma2, across2, ray, common, label, grey, seen_ns, drive = per_point
    start = np.concatenate([[0], np.cumsum(length)])
    counted = {reason: count for reason, count in left_out.items() if count}
    return MapPoints(
        xyz, sigma2, across2, ray, common, label, grey, seen_ns, drive, start, vote_class, vote_weight, drive_ids, counted
    )  # fmt: skip


def _none() -> tuple[NDArray[np.generic], ...]:
    """The columns of no points."""
    zero, whole, byte = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.uint8)
    return np.zeros((0, 3)), zero, zero, np.zeros((0, 3)), np.zeros((0, 3, 3)), byte, byte, whole, whole, whole, byte, whole


def _points_of(
    item: PlacedSubmap, drive: int, box: Box, settings: MergeSettings, left_out: dict[str, int]
) -> tuple[NDArray[np.generic], ...]:
    """The columns of one submap's points within the box. Sums run over whole submaps: a point has the same bits in any box."""
    submap, xyz = item.submap, item.points_enu()
    check_reach(item, xyz, settings.voxel_m)
    inside = ((xyz[:, :2] >= box.low) & (xyz[:, :2] < box.high)).all(axis=1)
    core = ((xyz[:, :2] >= box.core_low) & (xyz[:, :2] < box.core_high)).all(axis=1)
    persons = np.isin(submap.label, PERSONS)
    for name, members in (("persons", persons), ("sky", submap.label == SKY), ("void", submap.label == VOID)):
        left_out[name] += int((members & core).sum())
    rows = np.flatnonzero(inside & ~persons & (submap.label != SKY) & (submap.label != VOID))
    away = xyz - item.track_enu()[submap.keyframe]
    range_m = np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + away[:, 2] ** 2)
    sigma2 = submap.variance.astype(np.float64)
    across2 = np.minimum((settings.across_rad * range_m) ** 2 + settings.surface_floor_m**2, sigma2)
    return (
        xyz[rows],
        sigma2[rows],
        across2[rows],
        (away / np.maximum(range_m, 1e-9)[:, None])[rows],
        point_covariance(xyz, item.covariance)[rows],
        submap.label[rows],
        submap.grey[rows],
        submap.seen_ns[rows],
        np.full(len(rows), drive),
        *_votes(item, rows),
    )


def check_reach(item: PlacedSubmap, xyz: FloatArray, voxel_m: float) -> None:
    """Raises StageError where a point lies beyond the grid."""
    if len(xyz) and (np.abs(np.floor(xyz / voxel_m)).max(axis=0) >= KEY_LIMITS).any():
        raise StageError(
            f"submap {item.submap.digest[:12]} lies {np.abs(xyz).max() / 1e3:.0f} km from its frame's origin: "
            "use the map frame of its own place"
        )


def point_covariance(xyz: FloatArray, covariance: FloatArray) -> FloatArray:
    """(P, 3, 3) m^2 that the covariance (6, 6) of a left perturbation gives points (P, 3); zero where it is not known.

    J S J^T with J = [I, -hat(p)].
    """
    if not np.isfinite(covariance).all():
        return np.zeros((len(xyz), 3, 3))
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(xyz), 3, 3)), -se3.hat(xyz)], axis=2)
    out = J @ covariance @ np.swapaxes(J, 1, 2)
    return np.asarray(0.5 * (out + np.swapaxes(out, 1, 2)))


def _votes(item: PlacedSubmap, rows: IntArray) -> tuple[IntArray, NDArray[np.uint8], IntArray]:
    """How many votes each of these points has, and the votes in fixed point."""
    submap = item.submap
    old = submap.vote_start.astype(np.int64)
    length = np.maximum(old[rows + 1] - old[rows], 1)
    start = np.concatenate([[0], np.cumsum(length)])
    vote_class = np.repeat(submap.label[rows], length)
    vote_weight = np.ones(start[-1], np.int64)
    has_votes = np.repeat(old[rows + 1] > old[rows], length)
    place = (np.repeat(old[rows] - start[:-1], length) + np.arange(start[-1]))[has_votes]
    vote_class[has_votes] = submap.vote_class[place]
    vote_weight[has_votes] = np.maximum(np.rint(submap.vote_weight[place].astype(np.float64) * VOTE_STEPS), 1).astype(np.int64)
    vote_weight[np.isin(vote_class, PERSONS)] = 0  # of submaps that were cut when they still had any
    return length, vote_class, vote_weight
