"""Window of keyframes: their images, the live and immature points, and the marginalisation prior."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend.inertial import NO_IMU
from wayloom.odometry.kernels.arrays import PATCH, Frames, Images, PointColumns, Rig
from wayloom.odometry.kernels.equations import relative_poses
from wayloom.odometry.kernels.inertial import Inertial
from wayloom.odometry.kernels.patch import fill_patches
from wayloom.odometry.kernels.point_rows import empty_points, forget_frame, join_points, take_points
from wayloom.odometry.kernels.tracking import project_points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def _no_frames() -> Frames:
    return Frames(
        np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros((0, 2)),
        np.zeros((0, 2)), np.zeros((0, 2)),
    )  # fmt: skip


def _no_points(capacity: int) -> PointColumns:
    return PointColumns(
        np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 8), np.float32), np.zeros((0, 8), np.float32),
        np.zeros(0, np.int64), np.zeros((0, capacity), np.int64),
    )  # fmt: skip


@dataclass(slots=True)
class ImmaturePoints:
    """Points of the window's keyframes that take no part in its adjustment: their poses are given, only their depth is estimated.

    points       as the live ones; closed is not used; rho 0 where nothing is known yet
    id           (N,) number of each point, counted through the drive with the live ones
    low, high    (N,) 1/m, between which the inverse depth lies
    information  (N,) of the inverse depth in the energy's units, 0 where it is not known
    traced, failures  (N,) searches that gave a new interval, and those that found nothing that fits
    """

    points: PointColumns
    id: IntArray
    low: FloatArray
    high: FloatArray
    information: FloatArray
    traced: IntArray
    failures: IntArray


def no_immature_points(capacity: int) -> ImmaturePoints:
    """An empty set, in a window of at most `capacity` keyframes."""
    none, nothing = np.zeros(0, np.int64), np.zeros(0)
    return ImmaturePoints(_no_points(capacity), none, nothing, nothing, nothing, none, none)


@dataclass(slots=True)
class Window:
    """The state that outlives a frame.

    images, frames, points  as the kernels take them (kernels/arrays.py)
    keyframe     (F,) row of each frame in the result's keyframes
    point_id     (N,) number of each live point, counted through the drive
    disparity_bias  (1,) px, δ of u_right = u_left - bf rho - δ
    hold_disparity_bias  whether adjustments leave it as it is
    held_bias_step  (2,) the step, px, that the bias would take if it were free, and that step's variance in the energy's units, of
                 the last adjustment in which it was held
    prior_H, prior_g  (1 + 8F, with an IMU 1 + 17F + 2): energy z^T H z - 2 g^T z of the state's deviation z from the first
                      estimates
    inlier, information  (N, F + 1) and (N,), of the last adjustment
    H            information of all unknowns but the points, as of the prior, at the last adjustment
    immature     points beside the live ones
    inertial     velocities, biases and gravity once the IMU is in use
    """

    images: Images
    frames: Frames
    points: PointColumns
    keyframe: IntArray
    point_id: IntArray
    disparity_bias: FloatArray
    prior_H: FloatArray
    prior_g: FloatArray
    immature: ImmaturePoints
    inlier: IntArray = field(default_factory=lambda: np.zeros((0, 1), np.int64))
    information: FloatArray = field(default_factory=lambda: np.zeros(0))
    H: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    inertial: Inertial = NO_IMU
    hold_disparity_bias: bool = False
    held_bias_step: FloatArray = field(default_factory=lambda: np.full(2, np.nan))

    def __len__(self) -> int:
        return len(self.keyframe)

    def index_of(self, keyframe: int) -> int:
        """Place in the window of a keyframe by its row in the result."""
        return int(np.flatnonzero(self.keyframe == keyframe)[0])

    @property
    def has_prior(self) -> bool:
        """Whether marginalisation has tied a keyframe to its first estimate."""
        return bool(self.frames.has_first.any())


def empty_window(shape: tuple[int, ...], capacity: int, disparity_bias: float, bias_information: float) -> Window:
    """A window for images (h, w) and at most `capacity` keyframes, the disparity bias (px) held there by the given
    information."""
    return Window(
        Images(np.zeros((capacity, *shape), np.uint8), np.zeros((capacity, *shape), np.uint8)),
        _no_frames(), _no_points(capacity), np.zeros(0, np.int64), np.zeros(0, np.int64), np.array([disparity_bias]),
        np.array([[bias_information]]), np.array([bias_information * disparity_bias]), no_immature_points(capacity),
    )  # fmt: skip


def add_keyframe(
    window: Window, left: NDArray[np.uint8], right: NDArray[np.uint8], T_cam_world: FloatArray, affine: FloatArray, keyframe: int
) -> None:
    """Append a keyframe: its images (h, w), the right one with aligned rows, pose (4, 4), (2,) a and b, its row in the result."""
    frames = window.frames
    slot = min(set(range(len(window.images.left))) - set(frames.slot.tolist()))
    window.images.left[slot], window.images.right[slot] = left, right
    new = (slot, T_cam_world, T_cam_world, 0, affine, affine, np.array([1.0, 0.0]))
    window.frames = Frames(*(np.concatenate([old, np.asarray(n)[None]]) for old, n in zip(frames, new, strict=True)))
    window.keyframe = np.append(window.keyframe, keyframe)
    before = len(window.keyframe) - 1
    window.prior_H, window.prior_g = with_rows(window.prior_H, window.prior_g, 1 + 8 * before, 8)


def with_rows(H: FloatArray, g: FloatArray, at: int, count: int) -> tuple[FloatArray, FloatArray]:
    """H (n, n) and g (n,) with `count` unknowns that nothing is known of, put in before unknown `at`."""
    n, after = len(g), at + count
    wider, longer = np.zeros((n + count, n + count)), np.zeros(n + count)
    wider[:at, :at], wider[:at, after:] = H[:at, :at], H[:at, at:]
    wider[after:, :at], wider[after:, after:] = H[at:, :at], H[at:, at:]
    longer[:at], longer[after:] = g[:at], g[at:]
    return wider, longer


def new_points(window: Window, pixels: IntArray, rho: FloatArray, gradient_scale: float) -> PointColumns:
    """Points at pixels (n, 2) of the newest keyframe with inverse depths rho (n,) 1/m."""
    n, newest = len(pixels), len(window) - 1
    colour, weight = np.empty((n, PATCH), np.float32), np.empty((n, PATCH), np.float32)
    fill_patches(window.images.left[window.frames.slot[newest]], pixels, gradient_scale**2, colour, weight)
    return PointColumns(
        np.full(n, newest, np.int64), pixels.astype(np.float64), rho, colour, weight, np.ones(n, np.int64),
        np.zeros((n, window.points.closed.shape[1]), np.int64),
    )  # fmt: skip


def joined(first: PointColumns, second: PointColumns) -> PointColumns:
    """The points of both, in that order."""
    out: PointColumns = empty_points(len(first.rho) + len(second.rho), first)
    join_points(first, second, out)
    return out


def chosen(points: PointColumns, rows: IntArray | BoolArray) -> PointColumns:
    """The points in these rows, or in this mask."""
    indices = indices_of(rows)
    out: PointColumns = empty_points(len(indices), points)
    take_points(points, indices, out)
    return out


def indices_of(rows: IntArray | BoolArray) -> IntArray:
    """Rows as numbers, of which arrays are taken faster than by a mask."""
    return np.flatnonzero(rows) if rows.dtype == np.bool_ else np.asarray(rows, np.int64)


def add_points(window: Window, points: PointColumns, numbers: IntArray) -> None:
    """Make points live, by their numbers. What the last adjustment knew of the live points is void until the next."""
    window.points = joined(window.points, points)
    window.point_id = np.append(window.point_id, numbers)
    window.inlier, window.information = np.zeros((len(window.point_id), len(window) + 1), np.int64), np.zeros(len(window.point_id))


def keep_points(window: Window, mask: BoolArray) -> None:
    """Forget the points that are not in mask (N,)."""
    rows = indices_of(mask)
    window.points = chosen(window.points, rows)
    window.point_id = window.point_id[rows]
    window.inlier, window.information = window.inlier.take(rows, axis=0), window.information[rows]


def remove_keyframe(window: Window, j: int) -> None:
    """Take frame j out; no live or immature point may be hosted in it. The prior's rows are the caller's."""
    window.frames = Frames(*(np.delete(column, j, axis=0) for column in window.frames))
    window.keyframe = np.delete(window.keyframe, j)
    forget_frame(window.points.host, window.points.closed, j)
    forget_frame(window.immature.points.host, window.immature.points.closed, j)
    window.inlier = np.delete(window.inlier, j, axis=1)


def project_into(window: Window, points: PointColumns, target: int, rig: Rig, border: float) -> FloatArray:
    """(N, 3): u, v px and inverse depth of points in keyframe `target`; u is NaN where out of view."""
    out = np.zeros((len(points.rho), 3))
    T = np.ascontiguousarray(relative_poses(window.frames, 0)[:, target])
    h, w = window.images.left.shape[1:]
    project_points(points.host, points.uv, points.rho, T, rig, h, w, border, out)
    return out
