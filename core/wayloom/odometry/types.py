"""Result of the odometry: trajectory, keyframes and points of a drive."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import IDENTITY, RightLens

FloatArray = NDArray[np.float64]
POINTS_AT_ONCE: Final = 65_536
"""Of which more than a few bytes each are in memory: a drive of an hour has five million points."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One pose for every frame of the log.

    t_ns         (N,) int64, the log's own time stamps
    T_world_cam  (N, 4, 4); where a frame was lost, the constant-motion guess
    tracked      (N,) whether the pose was really tracked
    segment      (N,) int32, counts up after each loss; frames of one segment are rigidly connected
    """

    t_ns: NDArray[np.int64]
    T_world_cam: FloatArray
    tracked: NDArray[np.bool_]
    segment: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class Keyframes:
    """Keyframes of a drive, K of them.

    frame        (K,) int32 index into the trajectory, increasing
    T_world_cam  (K, 4, 4), the final estimate
    affine       (K, 4) a_left, b_left, a_right, b_right of I = exp(a) I_scene + b
    segment      (K,) int32
    step_covariance  (K, 6, 6) float32 of the step T_before_cam from the keyframe before: of xi = (v, omega), m and rad, of
                 exp(xi) T_before_cam, in the axes of the camera before, as the window knew it when the keyframe came in
                 (`wayloom.odometry.backend.steps`), wider along its way where static stereo denies the window's motion
                 (`wayloom.odometry.backend.stereo_scale`). NaN where it is not known: at the first of a segment; everywhere by
                 default
    """

    frame: NDArray[np.int32]
    T_world_cam: FloatArray
    affine: FloatArray
    segment: NDArray[np.int32]
    step_covariance: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 6, 6), np.float32))

    def __post_init__(self) -> None:
        if len(self.step_covariance) != len(self.frame):
            object.__setattr__(self, "step_covariance", np.full((len(self.frame), 6, 6), np.nan, np.float32))

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, slots=True)
class Points:
    """The P points of the result, those that passed `result.point_filter`, and which keyframes really saw each.

    host           (P,) int32, row in Keyframes
    uv_host        (P, 2) float32 pixels in the host's left image
    inverse_depth  (P,) float32, 1/m along the host's z axis
    variance       (P,) float32, of inverse_depth, 1/m^2
    grey           (P,) uint8
    obs_start      (P + 1,) int64: point p was seen in keyframes obs_keyframe[obs_start[p]:obs_start[p + 1]], host left out
    obs_keyframe   (M,) int32, row in Keyframes, in which the point was an inlier in the left image, by energy and by NCC of patches
    obs_right      (M,) bool, whether the same holds for the right image of that keyframe
    host_right     (P,) bool, whether it was consistent with the right image of its host
    """

    host: NDArray[np.int32]
    uv_host: NDArray[np.float32]
    inverse_depth: NDArray[np.float32]
    variance: NDArray[np.float32]
    grey: NDArray[np.uint8]
    obs_start: NDArray[np.int64]
    obs_keyframe: NDArray[np.int32]
    obs_right: NDArray[np.bool_]
    host_right: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.host)

    def without_observations(self) -> "Points":
        """The points alone: of a long drive their observations are half of it."""
        none = np.zeros(len(self) + 1, np.int64), np.zeros(0, np.int32), np.zeros(0, bool)
        return Points(self.host, self.uv_host, self.inverse_depth, self.variance, self.grey, *none, self.host_right)


def no_points() -> Points:
    """Points of which there is none."""
    host, number, level, flag = np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros(0, np.uint8), np.zeros(0, bool)
    return Points(host, number.reshape(0, 2), number, number, level, np.zeros(1, np.int64), host, flag, flag)


@dataclass(frozen=True, slots=True)
class OdometryResult:
    """A tracked drive.

    rig     the rectified rig of the log; t_right_left includes the lens's displacement
    disparity_bias_px  δ of u_right = u_left - bf * inverse_depth - δ, as last estimated (0 where the log is perfect)
    row_coefficients   (3,) px: the right image's row offset dv = c0 (1 + y^2) + c1 x + c2 x y, x and y normalised coordinates;
            what the right camera's lens does to the rows is in it
    lens    relative lens of the right camera, which was undone in the right images
    report  JSON-ready facts: segments, losses and their reasons, keyframe counts, stage times
    """

    rig: StereoRig
    trajectory: Trajectory
    keyframes: Keyframes
    points: Points
    disparity_bias_px: float
    row_coefficients: FloatArray
    report: dict[str, Any] = field(default_factory=dict)
    lens: RightLens = IDENTITY

    def points_world(self, rows: NDArray[np.int64] | None = None) -> FloatArray:
        """(P, 3) m: every point, or those in some rows, in the drive's world frame."""
        p = self.points
        rows = np.arange(len(p)) if rows is None else rows
        out = np.empty((len(rows), 3))
        for first in range(0, len(rows), POINTS_AT_ONCE):
            some = rows[first : first + POINTS_AT_ONCE]
            rays = self.rig.camera.rays(p.uv_host[some].astype(np.float64))
            T = self.keyframes.T_world_cam[p.host[some]]
            p_host = rays / np.maximum(p.inverse_depth[some].astype(np.float64), 1e-9)[:, None]
            out[first : first + POINTS_AT_ONCE] = np.einsum("nij,nj->ni", T[:, :3, :3], p_host) + T[:, :3, 3]
        return out
