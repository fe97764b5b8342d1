"""Stereo direct sparse odometry on one page: every frame is aligned with the newest keyframe; where the view has changed enough it
becomes a keyframe itself, gets points by static stereo, and the window of keyframes is adjusted; what leaves the window stays as a
prior and as points of the result. After Engel, Koltun, Cremers, Direct Sparse Odometry, PAMI 2018, and Wang, Schwoerer, Cremers,
Stereo DSO, ICCV 2017. docs/odometry.md tells the energy, the unknowns and the reasons.
"""

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.geometry import se3
from wayloom.geometry.lens import IDENTITY, RightLens
from wayloom.logs.types import DriveLog
from wayloom.odometry import frame_source, warm_up
from wayloom.odometry.backend import ablation, adjustment, marginalisation, window
from wayloom.odometry.backend.visual_inertial import VisualInertial, for_log
from wayloom.odometry.debugging.recorder import Debug
from wayloom.odometry.kernels.arrays import Robust
from wayloom.odometry.kernels.linear import orthonormalise
from wayloom.odometry.points import activation, immature, selection
from wayloom.odometry.result.point_filter import PointFilter
from wayloom.odometry.result.result_builder import FrameRow, KeyframeRow, ResultBuilder
from wayloom.odometry.rig import rows
from wayloom.odometry.rig.calibration_observations import ObservationCollector
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.stopwatch import Stopwatch
from wayloom.odometry.tracking import alignment as tracking
from wayloom.odometry.tracking import keyframing, pyramid, recovery
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
DECIDE_EVERY = 128
"""Keyframes after which it is decided which points stay."""
RESTART_BIAS_INFORMATION = 10.0
"""times the first prior's: how firmly a new segment believes the disparity bias of the one before."""


def track(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens = IDENTITY, collector: ObservationCollector | None = None, debug: Debug | None = None,
    matches: FloatArray | None = None,
) -> OdometryResult:  # fmt: skip
    """Track a whole drive. One pose for every frame; the result is the same, bit for bit, for any number of threads.

    With threads > 1 the next pair is decoded while this one is tracked. lens : of the rig, where it is known; collector : gathers
    what the drive knows of its rig; debug : is told of every decision; matches : `feed.first_matches` of the settings' row_frames,
    where they are known already.

    Raises LogError for frames that cannot be read or that do not have the rig's size.
    """
    frame_source.check_rig(log)
    imu = for_log(log, settings)
    warm_up.compile_odometry(imu is not None, progress)
    with frame_source.one_opencv_thread():
        progress(0.0, "aligning the rows of left and right")
        right_rectifier = rows.RightRectifier(log.rig, lens, frame_source.fit_rows(log, settings.row_frames, lens, matches))
        odometry = Odometry(right_rectifier, settings, imu, collector, debug)
        for frame in frame_source.frames(log, threads, odometry.stopwatch, odometry.levels):
            odometry.process(frame)
            progress((frame.index + 1) / len(log), f"tracking, {len(odometry.harvest.keyframes)} keyframes")
        return odometry.finish()


class Odometry:
    """Feed the pairs of a drive in order to `process`; `finish` gives the result."""

    def __init__(
        self, right_rectifier: rows.RightRectifier, settings: OdometrySettings, imu: VisualInertial | None = None,
        collector: ObservationCollector | None = None, debug: Debug | None = None,
    ) -> None:  # fmt: skip
        self.settings, self.right_rectifier, self.collector, self.debug = settings, right_rectifier, collector, debug
        self.found: recovery.TrackingResult | None = None  # the last frame's alignment, where one was tried
        self.keyframe_reason = ""
        self.stereo_rig = rig = right_rectifier.rig
        self.rig = pyramid.rig_numbers(rig.camera, rig.t_right_left)
        self.levels = pyramid.level_count(rig.camera, settings.levels)
        self.cameras = pyramid.level_cameras(rig.camera, self.levels)
        self.robust = Robust(settings.huber, settings.max_energy, settings.static_weight, settings.observer_right_weight)
        self.imu, self.harvest, self.stopwatch = imu, ResultBuilder(), Stopwatch()
        self.recovery = recovery.Recovery(settings, rig, self.rig, self.cameras)
        self.t_ns: list[int] = []
        self.losses: list[dict[str, Any]] = []
        self.segment_frames: list[int] = []
        self.cell = selection.first_cell((rig.camera.height, rig.camera.width), settings.candidates)
        self.failed, self.last_tracked, self.tracked_before = 0, 0, 0
        self._reset(0.0, settings.bias_prior)

    def _reset(self, delta: float, bias_information: float) -> None:
        """An empty window; delta px."""
        shape = (self.stereo_rig.camera.height, self.stereo_rig.camera.width)
        self.window = window.empty_window(shape, self.settings.window + 1, delta, bias_information)
        self.window.hold_delta = self.settings.bias_gate > 0 and delta == 0.0 and self.right_rectifier.lens.is_ideal
        self.references: list[tracking.Reference] = []  # of the newest keyframes, newest last
        self.brightness, self.first_rms, self.smoothed_rms = np.array([1.0, 0.0]), math.inf, math.inf

    def process(self, frame: frame_source.GreyPair) -> None:
        """One pair; the right image is used at keyframes only."""
        left = frame.left
        self.t_ns.append(frame.t_ns)
        with self.stopwatch("pyramid"):
            images = pyramid.build(left, self.levels) if frame.images is None else frame.images
        T_expected, self.found, self.keyframe_reason = self._expected_pose(), None, "first of a segment"
        if recovery.is_blank(left, self.settings.min_contrast):
            self._hold(frame, T_expected, "the image is blank")
        elif not len(self.window):
            self._start_segment(frame, left, images, T_expected)
        else:
            self._follow(frame, left, images, T_expected)
        if self.debug is not None:
            self.debug.frame(self, frame, left)

    def interrupt(self) -> None:
        """The next frame does not join on to the last one: it starts a new segment, at the speed of the last two frames."""
        if len(self.window):
            self._end_segment()

    def _follow(self, frame: frame_source.GreyPair, left: Image, images: pyramid.Pyramid, T_expected: FloatArray) -> None:
        """Align a frame with the window; make it a keyframe if it is due, or start anew after too many failures."""
        with self.stopwatch("track"):
            found = self.found = self._align(left, images, T_expected)
        fit, keyframe, failure = found.fit, found.keyframe, found.failure
        if failure is not None:
            self.failed += 1
            gap_s = 1e-9 * (frame.t_ns - self.t_ns[self.last_tracked])
            if self.failed > self.settings.patience or gap_s > self.settings.max_gap_s:
                self.losses.append({"frame": frame.index, "reason": failure})
                self._end_segment()
                self._start_segment(frame, left, images, T_expected)
            else:
                self._hold(frame, T_expected, failure)
            return
        self._accept(fit)
        newest = self.references[-1]
        extent = left.shape[0] + left.shape[1]
        why: str | None = "found by an older keyframe"
        if keyframe == newest.keyframe:
            why = keyframing.reason(fit, newest, self.cameras[0], self.first_rms, extent, self.settings)
        if why is None:
            self.harvest.frames.append(FrameRow(keyframe, fit.T_frame_keyframe, True, self._segment()))
            return
        base = int(np.flatnonzero(self.window.keyframe == keyframe)[0])
        T_cam_world = fit.T_frame_keyframe @ self.window.frames.T_cam_world[base]
        orthonormalise(T_cam_world)
        self.keyframe_reason = why
        self._add_keyframe(frame, left, images, T_cam_world, _affine_after(self.window.frames.affine[base], fit.brightness))

    # ------------------------------------------------------------------ motion
    def _segment(self) -> int:
        return max(len(self.segment_frames) - 1, 0)

    def _expected_pose(self) -> FloatArray:
        """(4, 4) T_cam_world of the new frame by what the IMU felt, else by constant motion of the last two, in their
        real time; identity at the start."""
        n = len(self.harvest.frames)
        if n < 2:
            return self.harvest.T_cam_world(0) if n else np.eye(4)
        if self.imu is not None:
            T_world_cam = tuple(se3.inverse(self.harvest.T_cam_world(i)) for i in (n - 2, n - 1))
            predicted_pose = self.imu.expected_pose((T_world_cam[0], T_world_cam[1]), (self.t_ns[-3], self.t_ns[-2], self.t_ns[-1]))
            if predicted_pose is not None:
                return se3.inverse(predicted_pose)
        before = self.tracked_before if self.last_tracked == n - 1 else n - 2  # what was held in between is a guess, no motion
        dt_before, dt = 1e-9 * (self.t_ns[n - 1] - self.t_ns[before]), 1e-9 * (self.t_ns[n] - self.t_ns[n - 1])
        return tracking.constant_motion(self.harvest.T_cam_world(n - 1), self.harvest.T_cam_world(before), dt_before, dt)

    def _align(self, left: Image, images: pyramid.Pyramid, T_expected: FloatArray) -> recovery.TrackingResult:
        """The frame's alignment with a keyframe of the window, and why it is lost if it is."""
        n, tracked = len(self.harvest.frames), self.last_tracked
        dt, since = (1e-9 * (self.t_ns[-1] - self.t_ns[i]) for i in (-2, tracked))
        T_last, T_tracked = self.harvest.T_cam_world(n - 1), self.harvest.T_cam_world(tracked)
        sought = recovery.TrackingRequest(
            left,
            images,
            T_expected,
            T_last,
            T_tracked,
            dt,
            since,
            n - self.segment_frames[-1] <= 1,
            self.brightness,
            self.smoothed_rms,
        )
        return self.recovery.align(sought, self.references, self.window)

    def _accept(self, fit: tracking.Alignment) -> None:
        """The frame is tracked: keep what the next frame is judged by."""
        self.first_rms = fit.rms if math.isinf(self.first_rms) else self.first_rms
        self.smoothed_rms = max(fit.rms, 1.0) if math.isinf(self.smoothed_rms) else 0.7 * self.smoothed_rms + 0.3 * fit.rms
        self.tracked_before = self.last_tracked
        self.brightness, self.failed, self.last_tracked = fit.brightness, 0, len(self.harvest.frames)

    # ------------------------------------------------------------------ losses and segments
    def _hold(self, frame: frame_source.GreyPair, T_expected: FloatArray, reason: str) -> None:
        """Keep a frame that could not be tracked at its expected pose."""
        self.losses.append({"frame": frame.index, "reason": reason})
        row = len(self.harvest.keyframes) - 1
        T = T_expected if row < 0 else T_expected @ se3.inverse(self.harvest.keyframes[row].T_cam_world)
        self.harvest.frames.append(FrameRow(row, T, False, self._segment()))

    def _start_segment(self, frame: frame_source.GreyPair, left: Image, images: pyramid.Pyramid, T_expected: FloatArray) -> None:
        """Begin anew from static stereo at the expected pose; where stereo finds too little the frame is lost."""
        right = self._aligned_right(frame)
        _, found = activation.stereo_candidates(left, right, np.zeros((0, 2)), self.cell, self.settings, self.stopwatch)
        matched = int((found[:, 0] > 0).sum())
        if matched < self.settings.min_points:
            self._hold(frame, T_expected, f"stereo finds depth at {matched} points only")
            return
        self.segment_frames.append(len(self.harvest.frames))
        self.failed, self.last_tracked = 0, len(self.harvest.frames)
        self._add_keyframe(frame, left, images, T_expected, np.zeros(2))

    def _collect(self, frame: frame_source.GreyPair, left: Image) -> None:
        """Give the newest keyframe to the evidence of the rig."""
        if self.collector is not None:
            right, newest = frame.right, self.window.frames.T_cam_world[-1]
            self.collector.keyframe(frame.index, left, right, newest, self.right_rectifier, float(self.window.delta[0]))

    def _end_segment(self) -> None:
        """Every live point leaves into the result; the window is emptied, the disparity bias stays known."""
        if self.collector is not None:
            self.collector.interrupt()
        if len(self.window) == 1:  # a car that stood: what its own pair says of the points is all there is
            adjustment.adjust(self.window, self.rig, self.robust, self.settings.affine_prior, self.settings.adjust_iterations)
        self._harvest_points(np.ones(len(self.window.point_id), bool), np.ones(len(self.window.immature.low), bool))
        self._reset(float(self.window.delta[0]), RESTART_BIAS_INFORMATION * self.settings.bias_prior)

    # ------------------------------------------------------------------ keyframes
    def _add_keyframe(
        self, frame: frame_source.GreyPair, left: Image, images: pyramid.Pyramid, T_cam_world: FloatArray, affine: FloatArray
    ) -> None:
        """Make the frame a keyframe: points by static stereo, adjustment of the window, and what is too much for it leaves."""
        s, row = self.settings, len(self.harvest.keyframes)
        right = self._aligned_right(frame)
        self.harvest.keyframes.append(KeyframeRow(frame.index, self._segment(), T_cam_world, np.zeros(4)))
        self.harvest.frames.append(FrameRow(row, np.eye(4), True, self._segment()))
        window.add_keyframe(self.window, left, right, T_cam_world, affine, row)
        if self.imu is not None:
            self.imu.extend(self.window, self._keyframe_times())
        self._give_points(left, right)
        if len(self.window) > 1:
            if self.debug is not None:
                self.debug.adjustment(self)
            with self.stopwatch("adjust"):
                adjustment.adjust(self.window, self.rig, self.robust, s.affine_prior, s.adjust_iterations)
                adjustment.cull(self.window)
                if self.window.hold_delta and adjustment.bias_is_significant(self.window, s.grey_sigma, s.bias_gate):
                    self.window.hold_delta = False
            with self.stopwatch("trace"):
                self.harvest.observations.append(immature.trace(self.window, self.rig, self.robust))
        self.harvest.update_keyframes(self.window)
        if self.collector is not None:
            with self.stopwatch("evidence"):
                self._collect(frame, left)
        with self.stopwatch("marginalise"):
            while len(self.window) > s.window:
                self._marginalise_one()
            if row % DECIDE_EVERY == DECIDE_EVERY - 1:
                alive = np.concatenate([self.window.point_id, self.window.immature.id])
                self.harvest.settle(self._rule(), alive, self._segment())
        if self.imu is not None:
            self.imu.learn(self.window, self._keyframe_times())
        with self.stopwatch("reference"):
            newest = tracking.make_reference(self.window, len(self.window) - 1, images, self.cameras, self.rig, s.border)
        self.references = [r for r in self.references[-2:] if r.keyframe in self.window.keyframe] + [newest]
        self.brightness, self.first_rms = np.array([1.0, 0.0]), math.inf

    def _rule(self) -> PointFilter:
        return PointFilter(self.settings.min_observations, self.settings.min_confirmations, self.settings.max_relative_sigma)

    def _keyframe_times(self) -> list[int]:
        """Time stamps (ns) of the window's keyframes."""
        return [self.t_ns[self.harvest.keyframes[row].frame] for row in self.window.keyframe]

    def _aligned_right(self, frame: frame_source.GreyPair) -> Image:
        """The right image (h, w), its rows on the left's."""
        with self.stopwatch("decode"):
            right = frame.right
        with self.stopwatch("rows"):
            return self.right_rectifier.align(right)

    def _give_points(self, left: Image, right: Image) -> None:
        """New points for the newest keyframe; the rows of the right images follow what stereo finds."""
        given = activation.activate_points(
            self.window, left, right, self.rig, self.robust, self.cell, self.harvest.next_point, self.settings, self.stopwatch
        )  # fmt: skip
        self.harvest.next_point, self.cell = given.next_id, given.cell
        with self.stopwatch("rows"):
            self.right_rectifier.follow(left, right, given.pixels, given.disparity)

    def _marginalise_one(self) -> None:
        """One keyframe leaves the window, with its points and those out of sight."""
        j = marginalisation.leaving_keyframe(self.window.frames, self.window.points.host)
        gone = marginalisation.leaving_points(self.window, j)
        self.harvest.add_observations(self.window, ~gone, self.rig, self.robust, [j])
        self._harvest_points(gone, self.window.immature.points.host == j)
        marginalisation.marginalise(self.window, j, gone, self.rig, self.robust, self.settings.affine_prior)
        ablation.weaken_prior(self.window, self.settings.ablation, self.settings.bias_prior)

    def _harvest_points(self, gone: NDArray[np.bool_], gone_immature: NDArray[np.bool_]) -> None:
        """Keep the live points in gone (N,) and the immature ones in gone_immature (M,) in the result."""
        s, now, bf = self.settings, self.window, self.stereo_rig.bf
        self.harvest.add_observations(now, gone, self.rig, self.robust, list(range(len(now))))
        points = window.chosen(now.points, gone)
        self.harvest.add_points(now, points, now.point_id[gone], now.information[gone], bf, s.grey_sigma, s.disparity_sigma)
        left = immature.take(now, gone_immature)
        self.harvest.add_points(now, left.points, left.id, left.information, bf, s.grey_sigma, s.disparity_sigma)

    # ------------------------------------------------------------------ result
    def finish(self) -> OdometryResult:
        """The tracked drive; every point that is still alive leaves into it."""
        delta = float(self.window.delta[0])
        if self.debug is not None:
            self.debug.finish(self)
        self._end_segment()
        trajectory = self.harvest.trajectory(np.array(self.t_ns, np.int64))
        self.harvest.settle(self._rule(), np.zeros(0, np.int64), None)
        points = self.harvest.kept.points()
        return OdometryResult(
            self.stereo_rig, trajectory, self.harvest.final_keyframes(), points, delta, self.right_rectifier.all_rows(),
            self._report(len(points), delta), self.right_rectifier.lens,
        )  # fmt: skip

    def _report(self, points: int, delta: float) -> dict[str, Any]:
        """JSON-ready facts of the drive."""
        frames = self.harvest.frames
        ends = [*self.segment_frames[1:], len(frames)]
        return {
            "frames": len(frames),
            "tracked": sum(row.tracked for row in frames),
            "keyframes": len(self.harvest.keyframes),
            "points": points,
            "activated_points": self.harvest.next_point,
            "segments": [{"first_frame": a, "last_frame": b - 1} for a, b in zip(self.segment_frames, ends, strict=False)],
            "losses": self.losses,
            "disparity_bias_px": delta,
            "row_coefficients_px": [float(c) for c in self.right_rectifier.coefficients],
            "rows_off_px": self.right_rectifier.worst_px(),
            "right_lens": None if self.right_rectifier.lens.is_ideal else asdict(self.right_rectifier.lens),
            "imu": None if self.imu is None else self.imu.report(),
            "seconds": {part: round(seconds, 4) for part, seconds in sorted(self.stopwatch.seconds.items())},
        }


def _affine_after(affine: FloatArray, brightness: FloatArray) -> FloatArray:
    """(2,) a, b of a frame that is gain times brighter than one with (2,) a, b, plus offset: I = exp(a) I_scene + b."""
    gain, offset = brightness
    return np.array([affine[0] + math.log(max(gain, 1e-3)), offset + gain * affine[1]])
