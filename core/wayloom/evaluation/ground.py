"""Ground sheets against the exact ground of a simulated drive: coverage, height, kerbs, classes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.georeference.rigid import mean_motion
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, GroundSheet
from wayloom.logs.simulated_truth import SimulatedTruth
from wayloom.submaps.submap import Submap

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
TRUE_REACH_M: Final = 22.0
"""Ground further from a true camera is not taken: its pixels are metres long."""
NEAR_TRACK_M: Final = 15.0
KERB_WINDOW, KERB_AWAY_WINDOW, KERB_AWAY_M = 7, 17, 0.3
"""Cells, odd, over which the two sides of a kerb are averaged: all of them, and those that are so far from the other side."""
KERB_LEAST: Final = 6
"""Cells of each side that a kerb's height needs."""
KERB_HEIGHTS_M: Final = (0.04, 0.30)


@dataclass(frozen=True, slots=True)
class TrueGround:
    """Cells of CELL_M in true ENU from corner (2,) on: height (H, W) m of the ground, NaN where no true pixel saw any; class_id
    (H, W) uint8, 255 there; distance (H, W) m from the track."""

    corner: NDArray[np.int64]
    height: FloatArray
    class_id: NDArray[np.uint8]
    distance: NDArray[np.float32]

    def place(self, points: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], BoolArray]:
        """Row and column of points (N, >= 2) and whether they are inside."""
        at = np.floor(points[:, :2] / CELL_M).astype(np.int64) - self.corner
        inside = (at >= 0).all(axis=1) & (at[:, 1] < self.height.shape[0]) & (at[:, 0] < self.height.shape[1])
        return at[:, 1], at[:, 0], inside


def true_ground(truth: SimulatedTruth, camera: PinholeCamera) -> TrueGround:
    """What the truth images of all frames show of the ground. camera : the true left one."""
    centres = truth.T_enu_cam[:, :2, 3]
    corner = np.floor((centres.min(axis=0) - TRUE_REACH_M) / CELL_M).astype(np.int64)
    columns, rows = (np.ceil((centres.max(axis=0) + TRUE_REACH_M) / CELL_M).astype(np.int64) - corner).tolist()
    sums, counts = np.zeros((len(GROUND_CLASSES), rows * columns)), np.zeros((len(GROUND_CLASSES), rows * columns), np.int32)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1).astype(np.float64)
    rays = camera.rays(np.column_stack([u, v]))
    for index, T in enumerate(truth.T_enu_cam):
        depth, label = truth.depth_m(index).ravel(), truth.class_id(index).ravel()
        for k, class_id in enumerate(GROUND_CLASSES):
            seen = (label == class_id) & (depth > 0.0) & (depth < TRUE_REACH_M)
            points = se3.transform(T, rays[seen] * depth[seen, None])
            at = np.floor(points[:, :2] / CELL_M).astype(np.int64) - corner
            inside = (at >= 0).all(axis=1) & (at[:, 0] < columns) & (at[:, 1] < rows)
            flat = at[inside, 1] * columns + at[inside, 0]
            np.add.at(sums[k], flat, points[inside, 2])
            np.add.at(counts[k], flat, 1)
    best = np.argmax(counts, axis=0)
    count = np.take_along_axis(counts, best[None], axis=0)[0]
    height = np.take_along_axis(sums, best[None], axis=0)[0] / np.maximum(count, 1)
    classes = np.where(count > 0, np.array(GROUND_CLASSES, np.uint8)[best], 255).astype(np.uint8)
    shape = (rows, columns)
    return TrueGround(
        corner, np.where(count > 0, height, np.nan).reshape(shape), classes.reshape(shape), _from_track(centres, corner, shape)
    )


def _from_track(centres: FloatArray, corner: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W) m from the nearest camera."""
    free = np.ones(shape, np.uint8)
    at = np.floor(centres / CELL_M).astype(np.int64) - corner
    free[at[:, 1], at[:, 0]] = 0
    return np.asarray(CELL_M * cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def true_place(submap: Submap, T_enu_cam: FloatArray) -> FloatArray:
    """T_enu_submap (4, 4) that true poses (N, 4, 4) of all frames give a submap: the mean over its keyframes."""
    return mean_motion(T_enu_cam[submap.keyframe_frame] @ se3.inverse(submap.T_submap_cam))


@dataclass(frozen=True, slots=True)
class SheetErrors:
    """Of the cells of one sheet whose true ground is known: error_m, sigma_m (N,), predicted and true class (N,) uint8, far (N,)
    m from the track; kerb_m, kerb_away_m (M, 2) estimated and true heights of kerbs, at them and from surfaces a little away;
    covered (H, W) cells of the truth."""

    error_m: FloatArray
    sigma_m: FloatArray
    class_id: NDArray[np.uint8]
    true_class: NDArray[np.uint8]
    far_m: NDArray[np.float32]
    kerb_m: FloatArray
    kerb_away_m: FloatArray
    covered: BoolArray


def compare(sheet: GroundSheet, T_enu_sheet: FloatArray, truth: TrueGround) -> SheetErrors:
    """A sheet at its true place against the true ground."""
    height = sheet.height
    r, c = np.nonzero(np.isfinite(height))
    xy = sheet.corner_m + (np.column_stack([c, r]) + 0.5) * CELL_M
    points = se3.transform(T_enu_sheet, np.column_stack([xy, height[r, c]]))
    row, column, inside = truth.place(points)
    covered = np.zeros(truth.height.shape, bool)
    covered[row[inside], column[inside]] = True
    true_height, true_class, far = np.full(len(r), np.nan), np.full(len(r), 255, np.uint8), np.full(len(r), np.inf, np.float32)
    true_height[inside] = truth.height[row[inside], column[inside]]
    true_class[inside] = truth.class_id[row[inside], column[inside]]
    far[inside] = truth.distance[row[inside], column[inside]]
    known = np.isfinite(true_height)
    on_grid = np.full(height.shape, np.nan)
    on_grid[r, c] = true_height
    class_grid = np.full(height.shape, 255, np.uint8)
    class_grid[r, c] = true_class
    at_edge = kerb_heights(height, on_grid, class_grid, 0.0, KERB_WINDOW)
    away = kerb_heights(height, on_grid, class_grid, KERB_AWAY_M, KERB_AWAY_WINDOW)
    return SheetErrors(
        (points[:, 2] - true_height)[known], sheet.sigma_mm[r, c][known] / 1000.0, sheet.label[r, c][known], true_class[known],
        far[known], at_edge, away, covered,
    )  # fmt: skip


def kerb_heights(
    height: FloatArray, true_height: FloatArray, true_class: NDArray[np.uint8], away_m: float, window: int
) -> FloatArray:
    """(M, 2) m: by how much the sidewalk is higher than the road, estimated and true, around the cells of kerbs.

    Means over `window` cells of what is at least away_m from the other side.
    """
    is_road, is_beside = true_class == GROUND_CLASSES[0], true_class == GROUND_CLASSES[1]
    known = np.isfinite(height) & np.isfinite(true_height)
    road = known & is_road & (_distance(is_beside) >= away_m)
    beside = known & is_beside & (_distance(is_road) >= away_m)
    steps = [_local_mean(values, beside, window) - _local_mean(values, road, window) for values in (height, true_height)]
    both = np.stack(steps, axis=-1)
    kerb = is_beside & (_distance(is_road) < 1.5 * CELL_M)
    real = kerb & np.isfinite(both).all(axis=-1) & (both[..., 1] > KERB_HEIGHTS_M[0]) & (both[..., 1] < KERB_HEIGHTS_M[1])
    return np.asarray(both[real], np.float64)


def _distance(of: BoolArray) -> FloatArray:
    """(H, W) m to the nearest cell of these."""
    return np.asarray(CELL_M * cv2.distanceTransform((~of).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float64)


def _local_mean(values: FloatArray, where: BoolArray, window: int) -> FloatArray:
    """(H, W) mean of the values where they count, over a square of `window` cells; NaN with fewer than KERB_LEAST."""
    count = cv2.boxFilter(where.astype(np.float64), -1, (window, window), normalize=False)
    total = cv2.boxFilter(np.where(where, values, 0.0), -1, (window, window), normalize=False)
    return np.where(count > KERB_LEAST - 0.5, total / np.maximum(count, 1.0), np.nan)


@dataclass(frozen=True, slots=True)
class GroundScores:
    """coverage by class id, of true ground within NEAR_TRACK_M; heights in m; errors of kerbs in m, median and 90th percentile;
    intersection over union by class id."""

    coverage: dict[int, float]
    median_m: float
    p95_m: float
    bias_m: float
    normalised_error: float
    kerb_m: tuple[float, float]
    kerb_away_m: tuple[float, float]
    kerbs: int
    iou: dict[int, float]


def scores(parts: Sequence[SheetErrors], truth: TrueGround) -> GroundScores:
    """Scores of all sheets of a drive together."""
    error, sigma = (np.concatenate([getattr(part, name) for part in parts]) for name in ("error_m", "sigma_m"))
    said, true, far = (np.concatenate([getattr(part, name) for part in parts]) for name in ("class_id", "true_class", "far_m"))
    near = far <= NEAR_TRACK_M
    error, sigma, said, true = error[near], sigma[near], said[near], true[near]
    covered = np.any([part.covered for part in parts], axis=0)
    reach = truth.distance <= NEAR_TRACK_M
    coverage = {
        k: float(covered[reach & (truth.class_id == k)].mean()) for k in GROUND_CLASSES if (reach & (truth.class_id == k)).any()
    }
    at, away = (np.concatenate([getattr(part, name) for part in parts]) for name in ("kerb_m", "kerb_away_m"))
    iou = {k: float(((said == k) & (true == k)).sum() / max(((said == k) | (true == k)).sum(), 1)) for k in GROUND_CLASSES}
    return GroundScores(
        coverage, float(np.median(np.abs(error))), float(np.percentile(np.abs(error), 95)), float(np.median(error)),
        float(np.sqrt(np.median((error / sigma) ** 2) / 0.4549)), _median_p90(at), _median_p90(away), len(at), iou,
    )  # fmt: skip


def _median_p90(steps: FloatArray) -> tuple[float, float]:
    """Of the differences of estimated and true steps (M, 2); NaN without any."""
    apart = np.abs(steps[:, 0] - steps[:, 1])
    return (float(np.median(apart)), float(np.percentile(apart, 90))) if len(apart) else (float("nan"), float("nan"))
