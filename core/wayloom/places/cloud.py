"""Static point cloud of a drive: its odometry's points, and more from the stereo pairs of some keyframes, thinned by voxels."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.files.growing_arrays import GrowingTable
from wayloom.labelling.types import PointLabels
from wayloom.odometry.points.selection import first_cell, select_candidates, spread_sample
from wayloom.odometry.types import POINTS_AT_ONCE, OdometryResult
from wayloom.places.settings import PlaceSettings
from wayloom.places.stereo_pair import STATIC, StereoPair
from wayloom.places.types import PlaceCloud

FloatArray = NDArray[np.float64]
BLOCK_PX = 32
MARGIN = 3.0
"""Grey values that a candidate's gradient must be over its surroundings' median."""
BORDER_PX = 6
LARGEST_SIGMA_CM = 255
AXIS_BITS = 21
"""A voxel's number holds three coordinates of so many bits: 400 km of 0.2 m."""


@dataclass(frozen=True, slots=True)
class HostedCloud:
    """The odometry's static points that are near and sure enough, and where in them each keyframe's begin: start (K + 1,)."""

    start: NDArray[np.int64]
    cloud: PlaceCloud

    def of_keyframe(self, k: int) -> PlaceCloud:
        """Those that a keyframe hosts."""
        return taken(self.cloud, slice(self.start[k], self.start[k + 1]))


def hosted_points(odometry: OdometryResult, labels: PointLabels, settings: PlaceSettings) -> HostedCloud:
    """Raises StageError when labels and points do not belong together."""
    if len(labels) != len(odometry.points):
        raise StageError(f"{len(labels)} labels for {len(odometry.points)} points: labelling and odometry are of different runs")
    p = odometry.points
    kept = np.zeros(len(p), bool)
    for block in _blocks(len(p)):
        depth, sigma = _depths(p.inverse_depth[block], p.variance[block])
        kept[block] = STATIC[labels.stereo[block]] & (depth < settings.cloud_depth_m) & (sigma < settings.cloud_sigma_m)
    rows = np.flatnonzero(kept)
    rows = rows[np.argsort(p.host[rows], kind="stable")]
    cloud = GrowingTable(no_cloud())
    for some in (rows[block] for block in _blocks(len(rows))):
        depth, sigma = _depths(p.inverse_depth[some], p.variance[some])
        p_cam = odometry.rig.camera.rays(p.uv_host[some].astype(np.float64)) * depth[:, None]
        cloud.append(packed(p.host[some], p_cam, labels.stereo[some], sigma))
    return HostedCloud(np.searchsorted(p.host[rows], np.arange(len(odometry.keyframes) + 1)), cloud.table())


def _blocks(count: int) -> list[slice]:
    return [slice(first, first + POINTS_AT_ONCE) for first in range(0, count, POINTS_AT_ONCE)]


def _depths(inverse_depth: NDArray[np.float32], variance: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Depths and their sigmas, m."""
    depth = 1.0 / np.maximum(inverse_depth.astype(np.float64), 1e-6)
    return depth, depth * depth * np.sqrt(variance.astype(np.float64))


def no_cloud() -> PlaceCloud:
    """A cloud without a point."""
    return packed(np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0))


def pair_points(pair: StereoPair, keyframe: int, odometry: OdometryResult, settings: PlaceSettings) -> PlaceCloud:
    """Static points of a keyframe's stereo pair, at pixels of high gradient spread over the image."""
    shape = pair.left.shape
    cell = max(2, int(first_cell(shape, settings.cloud_candidates)))
    pixels = select_candidates(pair.left, np.zeros((0, 2)), cell, BLOCK_PX, MARGIN, BORDER_PX)
    pixels = pixels[STATIC[pair.label[pixels[:, 1], pixels[:, 0]]]]
    pixels = pixels[spread_sample(pixels, settings.cloud_candidates)]
    depth, sigma = pair.depth(pixels, odometry)
    kept = (depth < settings.cloud_depth_m) & (sigma < settings.cloud_sigma_m)
    u, v = pixels[kept].T
    p_cam = odometry.rig.camera.rays(pixels[kept].astype(np.float64)) * depth[kept, None]
    return packed(np.full(kept.sum(), keyframe, np.int32), p_cam, pair.label[v, u], sigma[kept])


def packed(keyframe: NDArray[np.int32], p_cam: FloatArray, label: NDArray[np.uint8], sigma_m: FloatArray) -> PlaceCloud:
    """The points p_cam (n, 3) m in centimetres."""
    sigma_cm = np.clip(np.ceil(100.0 * sigma_m), 1, LARGEST_SIGMA_CM).astype(np.uint8)
    limits = np.iinfo(np.int16)
    return PlaceCloud(keyframe, np.clip(np.rint(100.0 * p_cam), limits.min, limits.max).astype(np.int16), label, sigma_cm)


def taken(cloud: PlaceCloud, rows: NDArray[np.int64] | slice) -> PlaceCloud:
    """These rows of a cloud."""
    return PlaceCloud(cloud.keyframe[rows], cloud.p_cam[rows], cloud.label[rows], cloud.sigma_cm[rows])


class VoxelFilter:
    """One point a voxel within a reach of road: what was kept further back does not count, because a drive that comes back there
    has drifted since."""

    def __init__(self, voxel_m: float, reach_m: float) -> None:
        self.voxel_m, self.reach_m = voxel_m, reach_m
        self._kept: deque[tuple[float, NDArray[np.int64]]] = deque()
        self._taken = np.zeros(0, np.int64)
        """Numbers of all that are kept, increasing."""

    def rows(self, points_world: FloatArray, sigma_cm: NDArray[np.uint8], road_m: float) -> NDArray[np.int64]:
        """Rows (m,) of the points (n, 3) m to keep, increasing: in every voxel that is free the surest, of equals the first."""
        while self._kept and self._kept[0][0] < road_m - self.reach_m:
            self._taken = np.delete(self._taken, np.searchsorted(self._taken, self._kept.popleft()[1]))
        number = voxel_numbers(points_world, self.voxel_m)
        free = ~_among(number, self._taken)
        order = np.lexsort((sigma_cm, number))
        first = np.ones(len(order), bool)
        first[1:] = number[order[1:]] != number[order[:-1]]
        chosen: NDArray[np.int64] = np.sort(order[first & free[order]])
        new = np.sort(number[chosen])
        self._kept.append((road_m, new))
        self._taken = np.insert(self._taken, np.searchsorted(self._taken, new), new)
        return chosen


def _among(numbers: NDArray[np.int64], increasing: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) which of the numbers (n,) are in the other ones (m,)."""
    if not len(increasing):
        return np.zeros(len(numbers), bool)
    at = np.searchsorted(increasing, numbers)
    return np.asarray(increasing[np.minimum(at, len(increasing) - 1)] == numbers)


def voxel_numbers(points: FloatArray, voxel_m: float) -> NDArray[np.int64]:
    """(n,) one number for each voxel."""
    half, mask = 1 << (AXIS_BITS - 1), (1 << AXIS_BITS) - 1
    cell = (np.floor(points / voxel_m).astype(np.int64) + half) & mask
    numbers: NDArray[np.int64] = (cell[:, 0] << 2 * AXIS_BITS) | (cell[:, 1] << AXIS_BITS) | cell[:, 2]
    return numbers
