"""Builder of the odometry's result: poses of frames and keyframes, and the points that left the window.

Points that left are decided upon now and then (`decide_points`), so that what is kept of them does not grow with the drive.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.adjustment import observations
from wayloom.odometry.kernels.arrays import PointColumns, Rig, Robust
from wayloom.odometry.result.point_filter import KeptPoints, PointFilter
from wayloom.odometry.types import Keyframes, Trajectory

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
CENTRE = 4
"""The centre's place in the patch pattern."""


@dataclass(slots=True)
class KeyframeRow:
    """A keyframe as last estimated; affine (4,) a_left, b_left, a_right, b_right; step_covariance (6, 6), NaN while unknown, and
    beside it along_variance, m^2, of the step along its own direction."""

    frame: int
    segment: int
    T_cam_world: FloatArray
    affine: FloatArray
    step_covariance: FloatArray = field(default_factory=lambda: np.full((6, 6), np.nan))
    along_variance: float = 0.0


@dataclass(slots=True)
class FrameRow:
    """A frame: its keyframe's row (-1: none yet, the pose is T_cam_world), its pose against it, whether it was tracked."""

    t_ns: int
    keyframe: int
    T_frame_keyframe: FloatArray
    tracked: bool
    segment: int


@dataclass(slots=True)
class ResultBuilder:
    """Grows by frames, keyframes and leaving points. Point numbers are given out by `next_point`.

    segment_starts : index of the first frame of each segment; frames before the first belong to segment 0
    """

    keyframes: list[KeyframeRow] = field(default_factory=list)
    frames: list[FrameRow] = field(default_factory=list)
    segment_starts: list[int] = field(default_factory=list)
    next_point: int = 0
    observations: list[NDArray[np.int64]] = field(default_factory=list)
    """(n, 3) each: point, keyframe, what is noted of it (`arrays.RIGHT` …)."""
    points: list[dict[str, NDArray[np.generic]]] = field(default_factory=list)
    """Points that left and are not yet decided about."""
    kept: KeptPoints = field(default_factory=KeptPoints)

    @property
    def segment(self) -> int:
        """Number of the segment that gets frames now."""
        return max(len(self.segment_starts) - 1, 0)

    def add_frame(self, t_ns: int, keyframe: int, T_frame_keyframe: FloatArray) -> None:
        """A tracked frame, by its keyframe's row and its pose (4, 4) against it."""
        self.frames.append(FrameRow(t_ns, keyframe, T_frame_keyframe, True, self.segment))

    def hold_frame(self, t_ns: int, T_cam_world: FloatArray) -> None:
        """A frame that was not tracked, at its predicted pose (4, 4): it follows the newest keyframe."""
        row = len(self.keyframes) - 1
        T = T_cam_world if row < 0 else T_cam_world @ se3.inverse(self.keyframes[row].T_cam_world)
        self.frames.append(FrameRow(t_ns, row, T, False, self.segment))

    def add_keyframe(self, frame: int, t_ns: int, T_cam_world: FloatArray) -> int:
        """Frame number `frame` is a keyframe at T_cam_world (4, 4); returns its row."""
        row = len(self.keyframes)
        self.keyframes.append(KeyframeRow(frame, self.segment, T_cam_world, np.zeros(4)))
        self.add_frame(t_ns, row, np.eye(4))
        return row

    def keyframe_times(self, window: Window) -> list[int]:
        """Time stamps (ns) of the window's keyframes."""
        return [self.frames[self.keyframes[row].frame].t_ns for row in window.keyframe]

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

    def add_step(self, covariance: FloatArray) -> None:
        """Note the covariance (6, 6) of the step to the newest keyframe."""
        self.keyframes[-1].step_covariance = covariance

    def doubt_steps(self, first: int, last: int, along_variance: float) -> None:
        """The steps from keyframe `first` to keyframe `last` may err along their way by this variance (m^2) each, at least."""
        for row in self.keyframes[first + 1 : last + 1]:
            row.along_variance = max(row.along_variance, along_variance)

    def add_observations(self, window: Window, mask: BoolArray, rig: Rig, robust: Robust, targets: list[int]) -> None:
        """Note in which frames `targets` of the window the points in mask (N,) are inliers, and by which images."""
        out = np.empty((len(mask) * len(targets), 3), np.int64)
        n = observations(
            window.images, rig, window.frames, window.points, window.inlier, mask, np.array(targets, np.int64),
            window.disparity_bias[0], robust, out,
        )  # fmt: skip
        point, frame, noted = out[:n].T
        self.observations.append(np.column_stack([window.point_id[point], window.keyframe[frame], noted]))

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

    def trajectory(self) -> Trajectory:
        """Every frame's final pose."""
        t_ns = np.array([row.t_ns for row in self.frames], np.int64)
        T = np.array([self.T_cam_world(i) for i in range(len(self.frames))]).reshape(-1, 4, 4)
        tracked = np.array([row.tracked for row in self.frames], bool)
        segment = np.array([row.segment for row in self.frames], np.int32)
        return Trajectory(t_ns, se3.inverse(T), tracked, segment)

    def final_keyframes(self) -> Keyframes:
        """Every keyframe's final estimate."""
        rows = self.keyframes
        T_world_cam = se3.inverse(np.array([row.T_cam_world for row in rows]).reshape(-1, 4, 4))
        return Keyframes(
            np.array([row.frame for row in rows], np.int32),
            T_world_cam,
            np.array([row.affine for row in rows]).reshape(-1, 4),
            np.array([row.segment for row in rows], np.int32),
            self._step_covariances(T_world_cam),
        )

    def _step_covariances(self, T_world_cam: FloatArray) -> NDArray[np.float32]:
        """(K, 6, 6) of `Keyframes.step_covariance`, what is doubted of steps between the poses T_world_cam (K, 4, 4) in it."""
        out = np.array([row.step_covariance for row in self.keyframes]).reshape(-1, 6, 6)
        for k in [k for k, row in enumerate(self.keyframes) if k and row.along_variance > 0.0]:
            t = (se3.inverse(T_world_cam[k - 1]) @ T_world_cam[k])[:3, 3]
            out[k, :3, :3] += self.keyframes[k].along_variance * np.outer(t, t) / max(float(t @ t), 1e-12)
        return out.astype(np.float32)

    def decide_points(self, point_filter: PointFilter, alive: NDArray[np.int64], segment: int | None) -> None:
        """Decide which of the points that left are kept, and forget what was known of them.

        alive (n,) numbers of the points that have not left; segment: the one that still gets keyframes, None at the end. Points
        wait while one of a lower number lives and while further keyframes could change the decision: so the result is ordered by
        number and does not depend on how often this is called.
        """
        if not self.points:
            return
        column = {name: np.concatenate([part[name] for part in self.points]) for name in self.points[0]}
        seen = np.concatenate([np.zeros((0, 3), np.int64), *self.observations])
        ids, segments = column["id"].astype(np.int64), np.array([row.segment for row in self.keyframes], np.int64)
        of_host = segments[column["host"].astype(np.int64)]
        others = np.bincount(segments)[of_host] - 1
        undecided = (of_host == (-1 if segment is None else segment)) & (others < point_filter.enough_others)
        first_waiting = int(np.concatenate([[self.next_point], alive, ids[undecided]]).min())
        done, seen_done = ids < first_waiting, seen[:, 0] < first_waiting
        known = seen_done & np.isin(seen[:, 0], ids[done])
        self.kept.append({name: values[done] for name, values in column.items()}, seen[known], others[done], point_filter)
        self.points = [{name: values[~done] for name, values in column.items()}]
        self.observations = [seen[~seen_done]]
