"""Sampling of calibration observations from pieces of a drive, at a third of the odometry's cost.

A host's stereo matches are what the next images are aligned with, directly and down to half size, until the host's points have been
found in its targets; the last one is the next host. No window is adjusted: poses and depths of a match group are unknowns of the
calibration, and need a first guess only.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import DriveLog
from wayloom.odometry import frame_source
from wayloom.odometry.points import selection
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking import alignment as tracking
from wayloom.odometry.tracking import pyramid, recovery
from wayloom.odometry.tracking.frame import GreyPair

FloatArray = NDArray[np.float64]
REFERENCE_POINTS = 250
FINEST_LEVEL = 1
"""Of the pyramid: what is left of the motion is less than matches are searched for."""
REACH_M, REACH_RAD, REACH_S, PASSED_OVER = 0.5, 0.03, 0.5, 3
"""So far and so long the car goes in one step; frames between are passed over, so many at most: what creeps shows little new."""


class Sampler:
    """Feeds a collector with hosts and targets from a stretch of a log.

    reference, T_host_world  the open match group's host, None where the way was lost
    poses                    (t_ns, T_cam_world) of the last two frames that were looked at
    pass_over                frames between the last two, and once the last was looked at between it and the next
    """

    def __init__(
        self, log: DriveLog, settings: OdometrySettings, right_rectifier: RightRectifier, collector: ObservationCollector
    ) -> None:  # fmt: skip
        camera = log.rig.camera
        self.log, self.settings, self.right_rectifier, self.collector = log, settings, right_rectifier, collector
        self.levels = pyramid.level_count(camera, settings.levels)
        self.cameras = pyramid.level_cameras(camera, self.levels)
        self._forget()

    def go_on(self, frames: Iterator[int], wanted: int) -> None:
        """Those of these frames that are not passed over, each after the last one, until the collector has `wanted` groups."""
        while len(self.collector.finished) < wanted:
            index = next(islice(frames, self.pass_over, None), None)
            if index is None:
                return
            self._frame(frame_source.grey_pair(self.log, index))

    def _forget(self) -> None:
        """The next frame does not join on to the last one."""
        self.collector.interrupt()
        self.reference: tracking.Reference | None = None
        self.T_host_world, self.brightness = np.eye(4), np.array([1.0, 0.0])
        self.poses: list[tuple[int, FloatArray]] = []
        self.pass_over = 0

    def _frame(self, pair: GreyPair) -> None:
        if recovery.is_blank(pair.left, self.settings.min_contrast):
            self._forget()
            return
        images, T = pyramid.build(pair.left, self.levels), np.eye(4)
        if self.reference is not None:
            fit = self._aligned(self.reference, images, pair.t_ns)
            if recovery.fit_failure(fit, self.settings) is None:
                self.brightness, T = fit.brightness, fit.T_frame_keyframe @ self.T_host_world
                if self.collector.is_target(T):
                    self.collector.extend(self._posed(pair, T))
                self.pass_over = self._to_pass_over(pair.t_ns, T)
            else:
                self._forget()
        self.poses = [*self.poses[-1:], (pair.t_ns, T)]
        if self.collector.open is None:
            self._begin(pair, images, T)

    def _to_pass_over(self, t_ns: int, T_cam_world: FloatArray) -> int:
        """How many frames to pass over after one at T_cam_world (4, 4), by its way and time from the last one."""
        t_last, T_last = self.poses[-1]
        way = se3.log(T_cam_world @ se3.inverse(T_last))
        metres, radians = float(np.linalg.norm(way[:3])), float(np.linalg.norm(way[3:]))
        reaches = max(metres / REACH_M, radians / REACH_RAD, 1e-9 * (t_ns - t_last) / REACH_S)
        of_a_frame = reaches / (self.pass_over + 1)
        return max(0, int(1.0 / max(of_a_frame, 1.0 / (PASSED_OVER + 1))) - 1)

    def _begin(self, pair: GreyPair, images: pyramid.Pyramid, T_cam_world: FloatArray) -> None:
        """Make the frame a host, what its points are matched with the reference; where there are too few the way is lost."""
        aligned = self.right_rectifier.align(pair.right)
        pixels, disparity = self.collector.host_matches(pair.left, aligned)
        self.collector.begin(self._posed(pair, T_cam_world), pixels, disparity)
        if self.collector.open is None:
            self._forget()
            return
        some = selection.spread_sample(pixels, REFERENCE_POINTS)
        rho = np.maximum(disparity[some], self.settings.min_disparity) / self.right_rectifier.rig.bf
        levels = tracking.reference_levels(pixels[some].astype(np.float64), rho, images, self.cameras)
        self.reference, self.T_host_world = tracking.Reference(0, levels), T_cam_world
        self.brightness = np.array([1.0, 0.0])

    def _posed(self, pair: GreyPair, T_cam_world: FloatArray) -> PosedPair:
        """The pair at T_cam_world (4, 4); no disparity bias is known."""
        return PosedPair(pair.index, pair.left, pair.right, T_cam_world, self.right_rectifier, 0.0)

    def _aligned(self, reference: tracking.Reference, images: pyramid.Pyramid, t_ns: int) -> tracking.Alignment:
        """The frame's alignment with the host, from constant motion; from several speeds where none is known yet."""
        T_world_host, finest = se3.inverse(self.T_host_world), min(FINEST_LEVEL, self.levels - 1)
        (t_last, T_last), known = self.poses[-1], len(self.poses) > 1
        guesses = [T_last]
        if known:
            t_before, T_before = self.poses[0]
            guesses = [tracking.constant_motion(T_last, T_before, 1e-9 * (t_last - t_before), 1e-9 * (t_ns - t_last))]
        else:
            guesses += tracking.start_guesses(T_last, 1e-9 * (t_ns - t_last))
        fits = [
            tracking.align(
                images, reference, T @ T_world_host, self.brightness, self.cameras, self.levels - 1, finest, self.settings
            )
            for T in guesses
        ]  # fmt: skip
        seen = [fit for fit in fits if fit.visible >= self.settings.min_visible] or fits
        return min(seen, key=lambda fit: fit.rms if np.isfinite(fit.rms) else np.inf)
