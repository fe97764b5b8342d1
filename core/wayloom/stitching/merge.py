"""Order-independent voxel fusion of submaps: the same bits in any order of arrival, after any earlier merges and removals.

Everything that is summed is a whole number (fixed point), and sums of whole numbers know no order:
- the place of a point within its voxel in 1/4096 of the edge, weighted by its inverse variance in units of 1/16 m^-2,
- votes (sums of inverse depths, eq. 3) in units of 2^-16 per metre,
- counts, the newest time, and the set of drives.
An int64 holds the offsets of 10^10 points in one voxel at the greatest weight. Rounding to the fixed point moves a point by at most
1/8192 of the voxel's edge.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, MOVING_CLASSES, SKY, VOID
from wayloom.errors import StageError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.kernels.accumulate import add_points, add_voxels
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OFFSET_STEPS = 4096
WEIGHT_STEPS, MAX_WEIGHT = 16.0, 160_000  # of 1/m^2: a sigma of 1 cm
VOTE_STEPS = 65_536.0
KEY_BITS, KEY_BITS_UP = 22, 19  # 63 in all: 209 km east and north, 26 km up at 0.1 m, where the plane has left the Earth by 3 km
KEY_LIMIT, KEY_LIMIT_UP = 1 << (KEY_BITS - 1), 1 << (KEY_BITS_UP - 1)
KEY_LIMITS = np.array([KEY_LIMIT, KEY_LIMIT, KEY_LIMIT_UP])
STATIC_CLASSES = np.array([c for c in range(CLASS_COUNT) if c not in MOVING_CLASSES and c != SKY])
ADD_AFTER = 16  # submaps; so memory stays near that of the voxels, not of the points
NEVER_NS = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True)
class _Sums:
    """Sums of V voxels in fixed point: key (V,) packed and sorted, weight (V,), offset (V, 3), votes (V, 19), count (V,),
    last_seen_ns (V,)."""

    key: IntArray
    weight: IntArray
    offset: IntArray
    votes: IntArray
    count: IntArray
    last_seen_ns: IntArray

    @staticmethod
    def zeros(key: IntArray) -> "_Sums":
        n = len(key)
        return _Sums(
            key,
            np.zeros(n, np.int64),
            np.zeros((n, 3), np.int64),
            np.zeros((n, CLASS_COUNT), np.int64),
            np.zeros(n, np.int64),
            np.full(n, NEVER_NS),
        )


def merge(placed: Iterable[PlacedSubmap], settings: MergeSettings = MergeSettings()) -> VoxelMap:
    """The static layer of all submaps.

    placed : each submap of each drive; one that comes twice counts once
    Raises StageError when the submaps are of different frames, or lie beyond KEY_LIMITS voxels from the frame's origin.
    """
    frame: MapFrame | None = None
    keys_of_drive: dict[str, list[IntArray]] = {}
    met: set[tuple[str, str]] = set()
    sums: list[_Sums] = []
    left_out = {"moving": 0, "sky": 0, "void": 0}
    for item in placed:
        if not met:
            frame = item.frame
        _check_frame(item, frame, keys_of_drive)
        name = (item.drive_id, item.submap.digest)
        if name in met:
            continue
        met.add(name)
        sums.append(_sum_submap(item, settings.voxel_m, left_out))
        keys_of_drive.setdefault(item.drive_id, []).append(sums[-1].key)
        if len(sums) == ADD_AFTER:
            sums = [_add(sums)]
    drives = _drives_of_voxels(keys_of_drive)
    return _voxel_map(_add(sums), drives, frame, settings.voxel_m, {k: v for k, v in left_out.items() if v})


def _check_frame(item: PlacedSubmap, frame: MapFrame | None, drives: Collection[str]) -> None:
    if item.frame != frame:
        raise StageError(
            f"drive {item.drive_id} lies in the frame {item.frame}, the others in {frame}: geo-reference them in one frame"
        )
    if frame is None and drives and item.drive_id not in drives:
        raise StageError(f"drive {item.drive_id} has no GNSS, so it has no place beside other drives: merge it alone")


def pack(keys: IntArray) -> IntArray:
    """keys (V, 3) to one sortable whole number each."""
    shifted = keys + KEY_LIMITS
    return np.asarray((shifted[:, 0] << (KEY_BITS + KEY_BITS_UP)) | (shifted[:, 1] << KEY_BITS_UP) | shifted[:, 2])


def unpack(packed: IntArray) -> IntArray:
    """The inverse of `pack`."""
    mask, mask_up = (1 << KEY_BITS) - 1, (1 << KEY_BITS_UP) - 1
    shifted = np.column_stack([packed >> (KEY_BITS + KEY_BITS_UP), (packed >> KEY_BITS_UP) & mask, packed & mask_up])
    return np.asarray(shifted - KEY_LIMITS)


def _sum_submap(item: PlacedSubmap, voxel_m: float, left_out: dict[str, int]) -> _Sums:
    submap = item.submap
    in_voxels = item.points_enu() / voxel_m
    keys = np.floor(in_voxels).astype(np.int64)
    if len(keys) and (np.abs(keys).max(axis=0) >= KEY_LIMITS).any():
        far_km = np.abs(in_voxels).max() * voxel_m / 1e3
        raise StageError(
            f"submap {submap.digest[:12]} lies {far_km:.0f} km from its frame's origin: use the map frame of its own place"
        )
    rows = np.flatnonzero(_static(submap.label, left_out))
    packed = pack(keys[rows])
    key, voxel = np.unique(packed, return_inverse=True)
    sums = _Sums.zeros(key)
    offset = np.floor((in_voxels[rows] - keys[rows]) * OFFSET_STEPS).astype(np.int64)
    weight = np.clip(np.rint(WEIGHT_STEPS / submap.variance[rows].astype(np.float64)), 1, MAX_WEIGHT).astype(np.int64)
    start, vote_class, vote_weight = _votes(item, rows)
    add_points(
        voxel.astype(np.int64),
        weight,
        np.minimum(offset, OFFSET_STEPS - 1),
        submap.seen_ns[rows],
        start,
        vote_class,
        vote_weight,
        sums.weight,
        sums.offset,
        sums.votes,
        sums.count,
        sums.last_seen_ns,
    )
    return sums


def _static(label: NDArray[np.uint8], left_out: dict[str, int]) -> NDArray[np.bool_]:
    """(P,) points of things that stand still; the others are counted."""
    moving, sky, void = np.isin(label, MOVING_CLASSES), label == SKY, label == VOID
    for name, members in (("moving", moving), ("sky", sky), ("void", void)):
        left_out[name] += int(members.sum())
    return np.asarray(~(moving | sky | void))


def _votes(item: PlacedSubmap, rows: IntArray) -> tuple[IntArray, NDArray[np.uint8], IntArray]:
    """The ragged votes of these points in fixed point, at least one step each; a point without any votes one step for its label."""
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
    return start, vote_class, vote_weight


def _add(parts: list[_Sums]) -> _Sums:
    """One table of sums from several."""
    key = np.unique(np.concatenate([np.zeros(0, np.int64), *(part.key for part in parts)]))
    out = _Sums.zeros(key)
    for part in parts:
        add_voxels(
            np.searchsorted(key, part.key),
            part.weight,
            part.offset,
            part.votes,
            part.count,
            part.last_seen_ns,
            out.weight,
            out.offset,
            out.votes,
            out.count,
            out.last_seen_ns,
        )
    return out


def _drives_of_voxels(keys_of_drive: dict[str, list[IntArray]]) -> IntArray:
    """(V,) how many drives saw each voxel, in the order of the keys."""
    keys = [np.unique(np.concatenate(parts)) for parts in keys_of_drive.values()]
    _, drives = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]), return_counts=True)
    return drives


def _voxel_map(total: _Sums, drives: IntArray, frame: MapFrame | None, voxel_m: float, left_out: dict[str, int]) -> VoxelMap:
    keys = unpack(total.key)
    # The middle of the step that the offset was floored to.
    within = (total.offset / np.maximum(total.weight, 1)[:, None] + 0.5) / OFFSET_STEPS
    return VoxelMap(
        frame,
        voxel_m,
        keys.astype(np.int32),
        (keys + within) * voxel_m,
        (total.votes / VOTE_STEPS).astype(np.float32),
        STATIC_CLASSES[np.argmax(total.votes[:, STATIC_CLASSES], axis=1)].astype(np.uint8),
        total.count.astype(np.uint32),
        np.minimum(drives, np.iinfo(np.uint16).max).astype(np.uint16),
        total.last_seen_ns,
        left_out,
    )
