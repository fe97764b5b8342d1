"""Tracker: direct alignment of every frame with the newest keyframe, recovery of lost frames, and the keyframe decision."""

import math

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.odometry.backend.visual_inertial import VisualInertial
from wayloom.odometry.backend.window import Window
from wayloom.odometry.result.result_builder import ResultBuilder
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.stopwatch import Stopwatch
from wayloom.odometry.tracking import alignment, keyframing, pyramid
from wayloom.odometry.tracking.frame import Frame, GreyPair
from wayloom.odometry.tracking.recovery import Recovery, TrackingRequest, TrackingResult

FloatArray = NDArray[np.float64]
REFERENCES = 3
"""Keyframes whose reference points are kept for alignment."""


class Tracker:
    """Gives each frame a predicted pose, aligns it with a keyframe of the window, and says when it must become a keyframe.

    references            (at most REFERENCES) of the newest keyframes, newest last
    brightness            (2,) gain, offset of the last frame against the newest keyframe
    first_rms             grey levels, of the first frame aligned with the newest keyframe; infinite before
    smoothed_rms          grey levels, running mean since the segment's start; infinite before
    failed                frames in a row that could not be tracked
    last_tracked, tracked_before  indices of the last two tracked frames
    """

    def __init__(
        self, rig: StereoRig, settings: OdometrySettings, builder: ResultBuilder, imu: VisualInertial | None, stopwatch: Stopwatch
    ) -> None:
        self.settings, self.builder, self.imu, self.stopwatch = settings, builder, imu, stopwatch
        self.levels = pyramid.level_count(rig.camera, settings.levels)
        self.cameras = pyramid.level_cameras(rig.camera, self.levels)
        self.rig = pyramid.rig_numbers(rig.camera, rig.t_right_left)
        self.image_extent = rig.camera.width + rig.camera.height
        self.recovery = Recovery(settings, rig, self.rig, self.cameras)
        self.failed, self.last_tracked, self.tracked_before = 0, 0, 0
        self.reset()

    def reset(self) -> None:
        """Forget the keyframes: the window was given up."""
        self.references: list[alignment.Reference] = []
        self.brightness, self.first_rms, self.smoothed_rms = np.array([1.0, 0.0]), math.inf, math.inf

    def prepare(self, pair: GreyPair) -> Frame:
        """The pair with its pyramid and its predicted pose."""
        with self.stopwatch("pyramid"):
            images = pyramid.build(pair.left, self.levels) if pair.images is None else pair.images
        return Frame(pair, images, self._predicted_pose(pair.index, pair.t_ns))

    def align(self, frame: Frame, window: Window) -> TrackingResult:
        """The frame's alignment with a keyframe of the window; its `failure` says why it is not believed, where it is not."""
        with self.stopwatch("track"):
            return self.recovery.align(self._request(frame), self.references, window)

    def accept(self, frame: Frame, result: TrackingResult) -> str | None:
        """Keep what the next frames are judged by; why this one must become a keyframe, None where it need not."""
        fit, newest = result.fit, self.references[-1]
        self.first_rms = fit.rms if math.isinf(self.first_rms) else self.first_rms
        self.smoothed_rms = max(fit.rms, 1.0) if math.isinf(self.smoothed_rms) else 0.7 * self.smoothed_rms + 0.3 * fit.rms
        self.tracked_before, self.last_tracked = self.last_tracked, frame.index
        self.brightness, self.failed = fit.brightness, 0
        if result.keyframe != newest.keyframe:
            return "found by an older keyframe"
        return keyframing.reason(fit, newest, self.cameras[0], self.first_rms, self.image_extent, self.settings)

    def gives_up(self, frame: Frame) -> bool:
        """Count a frame whose alignment failed; whether there were too many of them, or for too long."""
        self.failed += 1
        gap_s = 1e-9 * (frame.t_ns - self.builder.frames[self.last_tracked].t_ns)
        return self.failed > self.settings.patience or gap_s > self.settings.max_gap_s

    def start_segment(self, frame: Frame) -> None:
        """The frame is the first of a segment: motion is unknown again."""
        self.failed, self.last_tracked = 0, frame.index

    def add_reference(self, frame: Frame, window: Window) -> None:
        """The frame became the window's newest keyframe: the next ones are aligned with it."""
        with self.stopwatch("reference"):
            newest = alignment.make_reference(
                window, len(window) - 1, frame.images, self.cameras, self.rig, self.settings.border
            )  # fmt: skip
        self.references = [r for r in self.references[1 - REFERENCES :] if r.keyframe in window.keyframe] + [newest]
        self.brightness, self.first_rms = np.array([1.0, 0.0]), math.inf

    def _request(self, frame: Frame) -> TrackingRequest:
        rows, n = self.builder.frames, frame.index
        return TrackingRequest(
            frame=frame,
            T_last=self.builder.T_cam_world(n - 1),
            T_tracked=self.builder.T_cam_world(self.last_tracked),
            dt_s=1e-9 * (frame.t_ns - rows[n - 1].t_ns),
            since_s=1e-9 * (frame.t_ns - rows[self.last_tracked].t_ns),
            follows_held=self.last_tracked != n - 1,
            starting=n - self.builder.segment_starts[-1] <= 1,
            brightness=self.brightness,
            usual_rms=self.smoothed_rms,
        )

    def _predicted_pose(self, n: int, t_ns: int) -> FloatArray:
        """(4, 4) T_cam_world of frame n by what the IMU felt, else by constant motion of the last two, in their real time; identity
        at the start."""
        builder, rows = self.builder, self.builder.frames
        if n < 2:
            return builder.T_cam_world(0) if n else np.eye(4)
        if self.imu is not None:
            T_world_cam = se3.inverse(builder.T_cam_world(n - 2)), se3.inverse(builder.T_cam_world(n - 1))
            T_predicted = self.imu.predicted_pose(T_world_cam, (rows[n - 2].t_ns, rows[n - 1].t_ns, t_ns))
            if T_predicted is not None:
                return se3.inverse(T_predicted)
        before = self.tracked_before if self.last_tracked == n - 1 else n - 2  # what was held in between is a guess, no motion
        dt_before, dt = 1e-9 * (rows[n - 1].t_ns - rows[before].t_ns), 1e-9 * (t_ns - rows[n - 1].t_ns)
        return alignment.constant_motion(builder.T_cam_world(n - 1), builder.T_cam_world(before), dt_before, dt)
