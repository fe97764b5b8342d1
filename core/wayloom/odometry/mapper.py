"""Mapper: the window of keyframes with its points, photometric bundle adjustment over it, and marginalisation of what leaves it."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend import ablation, adjustment, marginalisation, steps, window
from wayloom.odometry.backend.inertial import is_inertial
from wayloom.odometry.backend.stereo_scale import StereoScale
from wayloom.odometry.backend.visual_inertial import VisualInertial
from wayloom.odometry.kernels.arrays import Robust
from wayloom.odometry.kernels.linear import orthonormalise
from wayloom.odometry.points import activation, immature, selection
from wayloom.odometry.points.activation import RectifiedPair
from wayloom.odometry.result.point_filter import PointFilter
from wayloom.odometry.result.result_builder import ResultBuilder
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.stopwatch import Stopwatch
from wayloom.odometry.tracking import pyramid
from wayloom.odometry.tracking.frame import Frame, GreyPair
from wayloom.odometry.tracking.recovery import TrackingResult

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
DECIDE_EVERY = 128
"""Keyframes after which it is decided which points stay."""
RESTART_BIAS_INFORMATION = 10.0
"""times the first prior's: how firmly a new segment believes the disparity bias of the one before."""


def _unobserved(mapper: "Mapper") -> None:
    """The default of `before_adjustment`: nobody is told."""


class Mapper:
    """Keeps the window: takes keyframes in, gives them points, adjusts, and lets keyframes and points leave into the result.

    before_adjustment : called with the mapper when the window is about to be adjusted
    cell : px, the cell of the next keyframe's candidates
    """

    def __init__(
        self, right_rectifier: RightRectifier, settings: OdometrySettings, builder: ResultBuilder, imu: VisualInertial | None,
        stopwatch: Stopwatch, before_adjustment: Callable[["Mapper"], None] = _unobserved,
    ) -> None:  # fmt: skip
        self.right_rectifier, self.settings, self.builder, self.imu = right_rectifier, settings, builder, imu
        self.stopwatch, self.before_adjustment = stopwatch, before_adjustment
        self.stereo_rig = rig = right_rectifier.rig
        self.rig = pyramid.rig_numbers(rig.camera, rig.t_right_left)
        self.robust = Robust(settings.huber, settings.max_energy, settings.static_weight, settings.observer_right_weight)
        self.cell = selection.first_cell((rig.camera.height, rig.camera.width), settings.candidates)
        self.window = self._empty_window(0.0, settings.bias_prior)
        self.stereo_scale = StereoScale()

    @property
    def disparity_bias(self) -> float:
        """px, δ of u_right = u_left - bf rho - δ, as last estimated."""
        return float(self.window.disparity_bias[0])

    def pose_of(self, result: TrackingResult) -> tuple[FloatArray, FloatArray]:
        """(4, 4) T_cam_world and (2,) a, b of a frame by its alignment with a keyframe of the window."""
        frames, base = self.window.frames, self.window.index_of(result.keyframe)
        T_cam_world = result.fit.T_frame_keyframe @ frames.T_cam_world[base]
        orthonormalise(T_cam_world)
        return T_cam_world, _affine_after(frames.affine[base], result.fit.brightness)

    def first_stereo(self, frame: Frame) -> RectifiedPair:
        """A frame's rectified pair with the static stereo that a segment may start from."""
        pair = self._rectified(frame)
        none = np.zeros((0, 2))
        candidates = activation.stereo_candidates(pair.left, pair.right, none, self.cell, self.settings, self.stopwatch)
        return RectifiedPair(pair.left, pair.right, candidates)

    def add_keyframe(self, frame: Frame, T_cam_world: FloatArray, affine: FloatArray, pair: RectifiedPair | None = None) -> None:
        """Make the frame a keyframe: points by static stereo, adjustment of the window, and what is too much for it leaves.

        T_cam_world (4, 4); affine (2,) a, b; pair : of `first_stereo`, where it is known already
        """
        pair = self._rectified(frame) if pair is None else pair
        row = self.builder.add_keyframe(frame.index, frame.t_ns, T_cam_world)
        window.add_keyframe(self.window, pair.left, pair.right, T_cam_world, affine, row)
        if self.imu is not None:
            self.imu.extend(self.window, self.builder.keyframe_times(self.window))
        self._activate_points(pair)
        if len(self.window) > 1:
            self._adjust()
        self.builder.update_keyframes(self.window)
        with self.stopwatch("marginalise"):
            while len(self.window) > self.settings.window:
                self._marginalise_one()
            if row % DECIDE_EVERY == DECIDE_EVERY - 1:
                alive = np.concatenate([self.window.point_id, self.window.immature.id])
                self.builder.decide_points(self.point_filter(), alive, self.builder.segment)
        if self.imu is not None:
            self.imu.learn(self.window, self.builder.keyframe_times(self.window))

    def newest_pair(self, pair: GreyPair) -> PosedPair:
        """The pair of the window's newest keyframe with all that is known of it."""
        T_cam_world = self.window.frames.T_cam_world[-1]
        return PosedPair(pair.index, pair.left, pair.right, T_cam_world, self.right_rectifier, self.disparity_bias)

    def end_segment(self) -> None:
        """Every live point leaves into the result; the window is emptied, the disparity bias stays known."""
        if len(self.window) == 1:  # a car that stood: what its own pair says of the points is all there is
            self._minimise()
        self._release_points(np.ones(len(self.window.point_id), bool), np.ones(len(self.window.immature.low), bool))
        self.window = self._empty_window(self.disparity_bias, RESTART_BIAS_INFORMATION * self.settings.bias_prior)

    def point_filter(self) -> PointFilter:
        """Which points stay in the result."""
        return PointFilter(self.settings.min_observations, self.settings.min_confirmations, self.settings.max_relative_sigma)

    def _empty_window(self, disparity_bias: float, bias_information: float) -> window.Window:
        camera = self.stereo_rig.camera
        out = window.empty_window((camera.height, camera.width), self.settings.window + 1, disparity_bias, bias_information)
        out.hold_disparity_bias = self.settings.bias_gate > 0 and disparity_bias == 0.0 and self.right_rectifier.lens.is_ideal
        return out

    def _rectified(self, frame: Frame) -> RectifiedPair:
        """The frame's images, the right one with its rows on the left's."""
        with self.stopwatch("decode"):
            right = frame.pair.right
        with self.stopwatch("rows"):
            return RectifiedPair(frame.left, self.right_rectifier.align(right))

    def _activate_points(self, pair: RectifiedPair) -> None:
        """New points for the newest keyframe; the rows of the right images follow what stereo finds."""
        activated = activation.activate_points(
            self.window, pair, self.rig, self.robust, self.cell, self.builder.next_point, self.settings, self.stopwatch
        )  # fmt: skip
        self.builder.next_point, self.cell = activated.next_id, activated.cell
        self.stereo_scale.add(int(self.window.keyframe[-1]), activated.witnesses)
        with self.stopwatch("rows"):
            self.right_rectifier.follow(pair.left, pair.right, activated.pixels, activated.disparity)

    def _minimise(self) -> None:
        adjustment.adjust(self.window, self.rig, self.robust, self.settings.affine_prior, self.settings.adjust_iterations)

    def _adjust(self) -> None:
        """Minimise the window's energy, close outliers, free a bias that has become significant, and trace immature points."""
        s = self.settings
        self.before_adjustment(self)
        with self.stopwatch("adjust"):
            self._minimise()
            self.builder.add_step(steps.step_covariance(self.window, s.grey_sigma))
            adjustment.cull(self.window)
            if self.window.hold_disparity_bias and adjustment.bias_is_significant(self.window, s.grey_sigma, s.bias_gate):
                self.window.hold_disparity_bias = False
        with self.stopwatch("scale"):
            self._judge_scale()
        with self.stopwatch("trace"):
            self.builder.observations.append(immature.trace(self.window, self.rig, self.robust))

    def _judge_scale(self) -> None:
        """Doubt the steps of the window where static stereo denies its motion; an IMU knows better whether the car did that."""
        if is_inertial(self.window.inertial):
            return
        span = self.stereo_scale.measure(self.window, self.rig, self.robust)
        if span is not None and span.is_off():
            self.builder.doubt_steps(span.first, span.last, span.step_variance)

    def _marginalise_one(self) -> None:
        """One keyframe leaves the window, with its points and those out of sight."""
        s = self.settings
        j = marginalisation.leaving_keyframe(self.window.frames, self.window.points.host)
        gone = marginalisation.leaving_points(self.window, j)
        self.builder.add_observations(self.window, ~gone, self.rig, self.robust, [j])
        self._release_points(gone, self.window.immature.points.host == j)
        marginalisation.marginalise(self.window, j, gone, self.rig, self.robust, s.affine_prior)
        ablation.weaken_prior(self.window, s.ablation, s.bias_prior)

    def _release_points(self, gone: BoolArray, gone_immature: BoolArray) -> None:
        """Keep the live points in gone (N,) and the immature ones in gone_immature (M,) in the result."""
        s, now, bf = self.settings, self.window, self.stereo_rig.bf
        self.builder.add_observations(now, gone, self.rig, self.robust, list(range(len(now))))
        points = window.chosen(now.points, gone)
        self.builder.add_points(now, points, now.point_id[gone], now.information[gone], bf, s.grey_sigma, s.disparity_sigma)
        left = immature.take(now, gone_immature)
        self.builder.add_points(now, left.points, left.id, left.information, bf, s.grey_sigma, s.disparity_sigma)


def _affine_after(affine: FloatArray, brightness: FloatArray) -> FloatArray:
    """(2,) a, b of a frame that is gain times brighter than one with (2,) a, b, plus offset: I = exp(a) I_scene + b."""
    gain, offset = brightness
    return np.array([affine[0] + math.log(max(gain, 1e-3)), offset + gain * affine[1]])
