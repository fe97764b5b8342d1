"""Stereo direct sparse odometry over a drive: a tracker and a mapper that share a window of keyframes.

Every frame is aligned with the newest keyframe (`tracker`); where the view has changed enough it becomes a keyframe itself, gets
points by static stereo, and the window of keyframes is adjusted (`mapper`); what leaves the window stays as a prior and as points
of the result (`result.result_builder`). After Engel, Koltun, Cremers, Direct Sparse Odometry, PAMI 2018, and Wang, Schwoerer,
Cremers, Stereo DSO, ICCV 2017. docs/odometry-design.md tells the energy, the unknowns and the reasons.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.geometry.lens import IDENTITY, RightLens
from wayloom.logs.types import DriveLog
from wayloom.odometry import frame_source, warm_up
from wayloom.odometry.backend.visual_inertial import VisualInertial, for_log
from wayloom.odometry.mapper import Mapper
from wayloom.odometry.observers import Observer
from wayloom.odometry.points.activation import RectifiedPair
from wayloom.odometry.result.result_builder import ResultBuilder
from wayloom.odometry.rig import rows
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.stopwatch import Stopwatch
from wayloom.odometry.tracker import Tracker
from wayloom.odometry.tracking.frame import Frame, GreyPair
from wayloom.odometry.tracking.frame_status import FIRST_OF_A_SEGMENT, FrameStatus
from wayloom.odometry.tracking.recovery import TrackingResult, is_blank
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]


def track(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens = IDENTITY, observers: Sequence[Observer] = (), matches: FloatArray | None = None, baseline_ratio: float = 1.0,
) -> OdometryResult:  # fmt: skip
    """Track a whole drive. One pose for every frame; the result is the same, bit for bit, for any number of threads.

    With threads > 1 the next pair is decoded while this one is tracked. lens : of the rig, where it is known; observers : told of
    every frame in this order; matches : `frame_source.first_matches` of the settings' row_frames, where they are known already;
    baseline_ratio : true baseline over that of the log, where the rig's file knows it.

    Raises LogError for frames that cannot be read or that do not have the rig's size.
    """
    frame_source.check_rig(log)
    imu = for_log(log, settings)
    warm_up.compile_odometry(imu is not None, progress)
    with frame_source.one_opencv_thread():
        progress(0.0, "aligning the rows of left and right")
        first_rows = frame_source.fit_rows(log, settings.row_frames, lens, matches)
        right_rectifier = rows.RightRectifier(log.rig.with_baseline(baseline_ratio), lens, first_rows)
        odometry = Odometry(right_rectifier, settings, imu, observers)
        for pair in frame_source.frames(log, threads, odometry.stopwatch, odometry.tracker.levels):
            status = odometry.process(pair)
            tell(observers, odometry, pair, status)
            progress((pair.index + 1) / len(log), f"tracking, {len(odometry.builder.keyframes)} keyframes")
        for observer in observers:
            observer.on_finish(odometry.mapper)
        return odometry.finish()


class Odometry:
    """Feed the pairs of a drive, from its first on, in order to `process`; `finish` gives the result.

    tracker, mapper, builder : the parts; each frame goes from one to the next
    """

    def __init__(
        self, right_rectifier: rows.RightRectifier, settings: OdometrySettings, imu: VisualInertial | None = None,
        observers: Sequence[Observer] = (),
    ) -> None:  # fmt: skip
        def before_adjustment(mapper: Mapper) -> None:
            for observer in observers:
                observer.on_adjustment(mapper)

        self.settings, self.imu, self.stopwatch, self.builder = settings, imu, Stopwatch(), ResultBuilder()
        self.tracker = Tracker(right_rectifier.rig, settings, self.builder, imu, self.stopwatch)
        self.mapper = Mapper(right_rectifier, settings, self.builder, imu, self.stopwatch, before_adjustment)
        self.losses: list[dict[str, Any]] = []

    def process(self, pair: GreyPair) -> FrameStatus:
        """Track one pair, the next of the drive; its right image is used at keyframes only."""
        frame = self.tracker.prepare(pair)
        if is_blank(frame.left, self.settings.min_contrast):
            status = self._hold(frame, "the image is blank")
        elif not len(self.mapper.window):
            status = self._start_segment(frame)
        else:
            status = self._follow(frame)
        self.losses += [{"frame": status.index, "reason": reason} for reason in status.failures]
        return status

    def finish(self) -> OdometryResult:
        """The tracked drive; every point that is still alive leaves into it."""
        right_rectifier, disparity_bias = self.mapper.right_rectifier, self.mapper.disparity_bias
        self.mapper.end_segment()
        self.builder.decide_points(self.mapper.point_filter(), np.zeros(0, np.int64), None)
        points = self.builder.kept.points()
        return OdometryResult(
            right_rectifier.rig, self.builder.trajectory(), self.builder.final_keyframes(), points, disparity_bias,
            right_rectifier.all_rows(), self._report(len(points), disparity_bias), right_rectifier.lens,
        )  # fmt: skip

    def _follow(self, frame: Frame) -> FrameStatus:
        """Align a frame with the window; make it a keyframe if it is due, or start anew after too many failures."""
        result = self.tracker.align(frame, self.mapper.window)
        if result.failure is not None:
            if not self.tracker.gives_up(frame):
                return self._hold(frame, result.failure, result)
            self._end_segment()
            begun = self._start_segment(frame)
            return replace(begun, lost=True, failures=(result.failure, *begun.failures), alignment=result)
        reason = self.tracker.accept(frame, result)
        if reason is None:
            self.builder.add_frame(frame.t_ns, result.keyframe, result.fit.T_frame_keyframe)
        else:
            self._add_keyframe(frame, *self.mapper.pose_of(result))
        return FrameStatus(frame.index, self.builder.segment, True, reason, alignment=result)

    def _hold(self, frame: Frame, failure: str, result: TrackingResult | None = None) -> FrameStatus:
        """Keep a frame that could not be tracked at its predicted pose."""
        self.builder.hold_frame(frame.t_ns, frame.T_predicted)
        return FrameStatus(frame.index, self.builder.segment, False, failures=(failure,), alignment=result)

    def _start_segment(self, frame: Frame) -> FrameStatus:
        """Begin anew from static stereo at the predicted pose; where stereo finds too little the frame is held."""
        pair = self.mapper.first_stereo(frame)
        if pair.matches < self.settings.min_points:
            return self._hold(frame, f"stereo finds depth at {pair.matches} points only")
        self.builder.segment_starts.append(frame.index)
        self.tracker.start_segment(frame)
        self._add_keyframe(frame, frame.T_predicted, np.zeros(2), pair)
        return FrameStatus(frame.index, self.builder.segment, True, FIRST_OF_A_SEGMENT, new_segment=True)

    def _end_segment(self) -> None:
        """Give the window up."""
        self.mapper.end_segment()
        self.tracker.reset()

    def _add_keyframe(self, frame: Frame, T_cam_world: FloatArray, affine: FloatArray, pair: RectifiedPair | None = None) -> None:
        self.mapper.add_keyframe(frame, T_cam_world, affine, pair)
        self.tracker.add_reference(frame, self.mapper.window)

    def _report(self, points: int, disparity_bias: float) -> dict[str, Any]:
        """JSON-ready facts of the drive."""
        frames, starts, right_rectifier = self.builder.frames, self.builder.segment_starts, self.mapper.right_rectifier
        ends = [*starts[1:], len(frames)]
        return {
            "frames": len(frames),
            "tracked": sum(row.tracked for row in frames),
            "keyframes": len(self.builder.keyframes),
            "points": points,
            "activated_points": self.builder.next_point,
            "segments": [{"first_frame": a, "last_frame": b - 1} for a, b in zip(starts, ends, strict=False)],
            "losses": self.losses,
            "doubted_steps": sum(row.along_variance > 0.0 for row in self.builder.keyframes),
            "disparity_bias_px": disparity_bias,
            "row_coefficients_px": [float(c) for c in right_rectifier.coefficients],
            "rows_off_px": right_rectifier.worst_px(),
            "right_lens": None if right_rectifier.lens.is_ideal else asdict(right_rectifier.lens),
            "imu": None if self.imu is None else self.imu.report(),
            "seconds": {part: round(seconds, 4) for part, seconds in sorted(self.stopwatch.seconds.items())},
        }


def tell(observers: Sequence[Observer], odometry: Odometry, pair: GreyPair, status: FrameStatus) -> None:
    """Tell the observers what became of a frame."""
    for observer in observers:
        if status.lost:
            observer.on_interrupt()
        if status.is_keyframe:
            with odometry.stopwatch("observers"):
                observer.on_keyframe(odometry.mapper.newest_pair(pair))
        observer.on_frame(pair, status, odometry.tracker, odometry.mapper)
