"""What is kept of a drive while it passes through the window, and its final form."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.kernels.adjustment import observations
from wayloom.odometry.kernels.arrays import PointColumns, Rig, Robust
from wayloom.odometry.types import Keyframes, Points, Trajectory
from wayloom.odometry.window import Window

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
CENTRE = 4
"""The centre's place in the patch pattern."""


@dataclass(slots=True)
class KeyframeRow:
    """A keyframe as last estimated; affine (4,) a_left, b_left, a_right, b_right."""

    frame: int
    segment: int
    T_cam_world: FloatArray
    affine: FloatArray


@dataclass(slots=True)
class FrameRow:
    """A frame: its keyframe's row (-1: none yet, the pose is T_cam_world), its pose against it, whether it was tracked."""

    keyframe: int
    T_frame_keyframe: FloatArray
    tracked: bool
    segment: int


@dataclass(slots=True)
class Harvest:
    """Grows by frames, keyframes and leaving points. Point numbers are given out by `next_point`."""

    keyframes: list[KeyframeRow] = field(default_factory=list)
    frames: list[FrameRow] = field(default_factory=list)
    next_point: int = 0
    observations: list[NDArray[np.int64]] = field(default_factory=list)
    """(n, 3) each: point, keyframe, 1 where its right image agrees."""
    points: list[dict[str, NDArray[np.generic]]] = field(default_factory=list)

    def T_cam_world(self, frame: int) -> FloatArray:
        """(4, 4) of a frame, by its keyframe's latest estimate."""
        row = self.frames[frame]
        if row.keyframe < 0:
            return row.T_frame_keyframe
        return np.asarray(row.T_frame_keyframe @ self.keyframes[row.keyframe].T_cam_world)

    def update_keyframes(self, window: Window) -> None:
        """Copy the window's estimates to its keyframes' rows."""
        frames = window.frames
        for i, k in enumerate(window.keyframe):
            (a, b), (gain, offset) = frames.affine[i], frames.gain_right[i]
            self.keyframes[k].T_cam_world = frames.T_cam_world[i].copy()
            self.keyframes[k].affine = np.array([a, b, a + math.log(gain), gain * b + offset])

    def add_observations(self, window: Window, mask: BoolArray, rig: Rig, robust: Robust, targets: list[int]) -> None:
        """Note in which frames `targets` of the window the points in mask (N,) are inliers, and whether the right image agrees."""
        out = np.empty((len(mask) * len(targets), 3), np.int64)
        n = observations(
            window.images, rig, window.frames, window.points, window.inlier, mask, np.array(targets, np.int64), window.delta[0],
            robust, out,
        )  # fmt: skip
        point, frame, right = out[:n].T
        self.observations.append(np.column_stack([window.point_id[point], window.keyframe[frame], right]))

    def add_points(
        self, window: Window, points: PointColumns, ids: NDArray[np.int64], information: FloatArray, bf: float, grey_sigma: float,
        disparity_sigma: float,
    ) -> None:  # fmt: skip
        """Keep leaving points (N) with their numbers and information (N,) as last estimated.

        variance = grey_sigma^2 / information + (disparity_sigma / bf)^2: the second part is the error common to all views (rows,
        lens, rectification), which the Hessian does not know.
        """
        variance = grey_sigma**2 / np.maximum(information, 1e-9) + (disparity_sigma / bf) ** 2
        grey = np.clip(np.round(points.colour[:, CENTRE]), 0, 255).astype(np.uint8)
        self.points.append(
            {
                "id": ids, "host": window.keyframe[points.host], "uv": points.uv, "rho": points.rho, "variance": variance,
                "grey": grey, "host_right": points.has_static > 0,
            }
        )  # fmt: skip

    def trajectory(self, t_ns: NDArray[np.int64]) -> Trajectory:
        """Every frame's final pose."""
        T = np.array([self.T_cam_world(i) for i in range(len(self.frames))]).reshape(-1, 4, 4)
        tracked = np.array([row.tracked for row in self.frames], bool)
        segment = np.array([row.segment for row in self.frames], np.int32)
        return Trajectory(t_ns.copy(), se3.inverse(T), tracked, segment)

    def final_keyframes(self) -> Keyframes:
        """Every keyframe's final estimate."""
        rows = self.keyframes
        return Keyframes(
            np.array([row.frame for row in rows], np.int32),
            se3.inverse(np.array([row.T_cam_world for row in rows]).reshape(-1, 4, 4)),
            np.array([row.affine for row in rows]).reshape(-1, 4),
            np.array([row.segment for row in rows], np.int32),
        )

    def final_points(self, min_observations: int, min_confirmations: int, max_relative_sigma: float) -> Points:
        """The points that ended well: seen by enough keyframes beside the host, in enough images, of sure depth; ordered by number.

        min_confirmations : images that agree, left and right ones of observers and the host's right one. In a segment with few
        keyframes all the others must have seen a point; where its host is the only one, the host's right image must agree.
        """
        if not self.points:
            return _points_of({}, np.zeros((0, 3), np.int64))
        column = {name: np.concatenate([part[name] for part in self.points]) for name in self.points[0]}
        seen = np.concatenate([np.zeros((0, 3), np.int64), *self.observations])
        seen = seen[np.lexsort((seen[:, 1], seen[:, 0]))]
        seen = seen[np.append(True, (np.diff(seen[:, :2], axis=0) != 0).any(axis=1))[: len(seen)]]  # seen while immature and live
        counts = np.bincount(seen[:, 0], minlength=self.next_point)[column["id"]]
        right = np.bincount(seen[:, 0], weights=seen[:, 2], minlength=self.next_point)[column["id"]]
        sure = np.sqrt(column["variance"]) < max_relative_sigma * column["rho"]
        segment = np.array([row.segment for row in self.keyframes], np.int64)
        others = np.bincount(segment)[segment[column["host"].astype(np.int64)]] - 1
        images = counts + right + column["host_right"].astype(np.int64)
        confirmed = (counts >= np.minimum(min_observations, others)) & (images >= np.minimum(min_confirmations, others + 1))
        good = np.flatnonzero(confirmed & sure)
        good = good[np.argsort(column["id"][good], kind="stable")]
        return _points_of({name: values[good] for name, values in column.items()}, seen)


def _points_of(column: dict[str, NDArray[np.generic]], seen: NDArray[np.int64]) -> Points:
    """Points from the kept columns, ordered by id, and the observations (m, 3) of all points, ordered by point and keyframe."""
    ids = column.get("id", np.zeros(0, np.int64))
    seen = seen[np.isin(seen[:, 0], ids)]
    start = np.append(np.searchsorted(seen[:, 0], ids), len(seen)).astype(np.int64)
    return Points(
        host=column.get("host", ids).astype(np.int32),
        uv_host=column.get("uv", np.zeros((0, 2))).astype(np.float32),
        inverse_depth=column.get("rho", ids).astype(np.float32),
        variance=column.get("variance", ids).astype(np.float32),
        grey=column.get("grey", ids).astype(np.uint8),
        obs_start=start,
        obs_keyframe=seen[:, 1].astype(np.int32),
        obs_right=seen[:, 2] > 0,
        host_right=column.get("host_right", ids).astype(np.bool_),
    )
