"""Calibration observations of a drive: refined matches between left and right and between keyframes, few enough to keep.

They come in groups (`MatchGroup`): a host keyframe, up to two later keyframes (its targets), and points of the host found in the
host's right image and in both images of the targets. Right pixels are those of the log's own right image, before
rows or lens are corrected: observations stay valid whatever is learnt of the rig later. `wayloom calibrate` learns from them;
docs/calibration.md.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.logs.types import DriveLog
from wayloom.odometry.kernels.matches import BORDER, HALF, match_patches
from wayloom.odometry.kernels.stereo import NO_MATCH
from wayloom.odometry.points import selection, stereo
from wayloom.odometry.rig.drive_name import drive_name
from wayloom.odometry.rig.posed_pair import PosedPair

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
TARGETS = 2
DISTANCES_M, ANGLES_RAD = (1.0, 2.5), (0.06, 0.15)
"""A target is the first keyframe that has moved or turned so far from the host."""
SPACING_M = 2.0
MOST_GROUPS = 48
MOST_POINTS = 240
LEAST_POINTS = 20
SMOOTHING_PX = 1.0
SMOOTHING = cv2.getGaussianKernel(9, SMOOTHING_PX, cv2.CV_32F)
MIN_EIGENVALUE = 10.0
"""grey^2/px^2 of the smoothed patch's structure tensor, a pixel: corners and textures, no edges."""
DEPTH_DOUBT_PX = 2.0
"""How wrong a first disparity may be: a target is searched along its epipolar line so far."""
MAX_REACH_PX = 12.0
GOOD_RMS = 2.0
"""grey levels. Patches across the edge of something near fit worse and lie wrong: the better half of a host's are kept, or those
under this; in targets, which look from elsewhere, TARGET_RMS times as much is allowed."""
TARGET_RMS = 1.5


@dataclass(frozen=True, slots=True)
class CalibrationObservations:
    """Matches of one drive; S groups, P points, T = 2 targets.

    name, rig_id   of the log, the name as `drive_name` gives it
    rig            the log's own calibration
    host_frame     (S,) int32, frame of the host
    target_frame   (S, T) int32, frames of the targets, -1 where there is none
    T_target_host  (S, T, 4, 4), as the odometry estimated it: a first guess
    group          (P,) int32, rising, the group of each point
    uv_host        (P, 2) pixels in the host's left image, whole numbers
    uv_right       (P, 2) float32, the match in the host's right image as the log gives it
    uv_left_target, uv_right_target   (P, T, 2) float32, the matches in the targets' left and right images; NaN where there is none
    """

    name: str
    rig_id: str | None
    rig: StereoRig
    host_frame: NDArray[np.int32]
    target_frame: NDArray[np.int32]
    T_target_host: FloatArray
    group: NDArray[np.int32]
    uv_host: NDArray[np.int32]
    uv_right: NDArray[np.float32]
    uv_left_target: NDArray[np.float32]
    uv_right_target: NDArray[np.float32]

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.host_frame)

    def __len__(self) -> int:
        return len(self.group)


@dataclass(slots=True)
class MatchGroup:
    """A group of matches that grows: its host's smoothed left image and its points; pixels (n, 2), inverse depths rho (n,) 1/m;
    limit: the largest rms residual of a match, grey levels."""

    frame: int
    T_cam_world: FloatArray
    left: NDArray[np.float32]
    pixels: NDArray[np.int64]
    rho: FloatArray
    uv_right: FloatArray
    limit: float
    at_m: float
    targets: list[tuple[int, FloatArray, FloatArray, FloatArray]] = field(default_factory=list)
    """frame, T_target_host (4, 4), left (n, 2) and right (n, 2) matches"""


class ObservationCollector:
    """Observer of every keyframe in order; `observations` gives what was gathered. The same drive gives the same bytes.

    most_points : of a group; finished : groups that are complete; open : the one that still gets targets
    """

    def __init__(self, rig: StereoRig, most_points: int = MOST_POINTS) -> None:
        self.rig, self.most_points = rig, most_points
        self.finished: list[MatchGroup] = []
        self.open: MatchGroup | None = None
        self.stride, self.seen, self.way_m = 1, 0, 0.0
        self.T_last: FloatArray | None = None
        self._last_smoothed: tuple[int, NDArray[np.float32], NDArray[np.float32]] | None = None

    def interrupt(self) -> None:
        """The drive was lost: what is open has no targets any more."""
        self.open, self.T_last = None, None

    def on_interrupt(self) -> None:
        """As an observer of the odometry."""
        self.interrupt()

    def on_adjustment(self, *_: object) -> None:
        """Not looked at."""

    def on_frame(self, *_: object) -> None:
        """Not looked at."""

    def on_finish(self, *_: object) -> None:
        """What is open stays without its targets."""
        self.interrupt()

    def on_keyframe(self, pair: PosedPair, /) -> None:
        """Match the open group in a new keyframe if it is far enough, or begin a group there."""
        if self.T_last is not None:
            self.way_m += float(np.linalg.norm(se3.inverse(pair.T_cam_world)[:3, 3] - se3.inverse(self.T_last)[:3, 3]))
        self.T_last = pair.T_cam_world.copy()
        if self.is_target(pair.T_cam_world):
            self.extend(pair)
        if self.open is None and (not self.finished or self.way_m - self.finished[-1].at_m >= SPACING_M * self.stride):
            self.begin(pair, *self.host_matches(pair.left, pair.right_rectifier.align(pair.right)))

    def host_matches(self, left: Image, aligned: Image) -> tuple[NDArray[np.int64], FloatArray]:
        """Stereo matches of a pair (h, w), the right image with aligned rows, four times as many as a group holds at most:
        pixels (n, 2) and disparities (n,) px."""
        cell = max(4, round(selection.first_cell(left.shape, 8 * self.most_points)))
        pixels = selection.select_candidates(left, np.zeros((0, 2)), cell, 32, 7.0, HALF + int(BORDER) + 2)
        found = stereo.match(left, aligned, pixels, left.shape[1] // 4, 0.85, 12.0, 60)
        good = np.flatnonzero(found[:, 1] < NO_MATCH)
        good = good[selection.spread_sample(pixels[good], 4 * self.most_points)]
        return pixels[good], found[good, 0]

    def begin(self, pair: PosedPair, pixels: NDArray[np.int64], disparity: FloatArray) -> None:
        """Open a group of this host, with those of its `host_matches` that are found again to a hundredth of a pixel; none where
        they are too few."""
        smooth, smooth_right = self._smoothed(pair)
        start = pair.right_rectifier.real_pixels(np.column_stack([pixels[:, 0] - disparity, pixels[:, 1]]))
        found = matched(smooth, smooth_right, pixels, start, np.ones(len(pixels)))
        fits = found[np.isfinite(found[:, 2]), 2]
        limit = max(GOOD_RMS, float(np.median(fits))) if len(fits) else GOOD_RMS
        uv_right = within(found, limit)
        known = np.flatnonzero(np.isfinite(uv_right[:, 0]))
        known = known[selection.spread_sample(pixels[known], self.most_points)]
        if len(known) >= LEAST_POINTS:
            rho = np.asarray((disparity[known] - pair.disparity_bias) / self.rig.bf, np.float64)
            self.open = MatchGroup(
                pair.frame, pair.T_cam_world.copy(), smooth, pixels[known], rho, uv_right[known], limit, self.way_m
            )  # fmt: skip

    def is_target(self, T_cam_world: FloatArray) -> bool:
        """Whether a frame at T_cam_world (4, 4) is far enough from the open group's host to be its next target."""
        if self.open is None:
            return False
        T = T_cam_world @ se3.inverse(self.open.T_cam_world)
        k = len(self.open.targets)
        return float(np.linalg.norm(T[:3, 3])) >= DISTANCES_M[k] or float(np.linalg.norm(se3.log(T)[3:])) >= ANGLES_RAD[k]

    def extend(self, pair: PosedPair) -> None:
        """Match the open group in this target; close it when it has all its targets or lost its points."""
        group = self.open
        if group is None:
            return
        T = pair.T_cam_world @ se3.inverse(group.T_cam_world)
        target, target_right = self._smoothed(pair)
        in_left = self._match_left(group, T, target)
        in_right = self._match_right(group, T, in_left, target_right, pair)
        enough = np.isfinite(in_left[:, 0]).sum() >= LEAST_POINTS
        if enough:
            group.targets.append((pair.frame, T, in_left, in_right))
        if len(group.targets) == TARGETS or not enough:
            self._close(group)

    def _smoothed(self, pair: PosedPair) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Both images (h, w) of a pair, smoothed; those of the last one are remembered: a target may be the next host."""
        if self._last_smoothed is None or self._last_smoothed[0] != pair.frame:
            self._last_smoothed = (pair.frame, smoothed(pair.left), smoothed(pair.right))
        return self._last_smoothed[1:]

    def _match_left(self, group: MatchGroup, T: FloatArray, target: NDArray[np.float32]) -> FloatArray:
        """(n, 2) px of the group's points in a target's smoothed left image, T (4, 4) from the host; NaN where not found."""
        camera = self.rig.camera
        q = camera.rays(group.pixels.astype(float)) @ T[:3, :3].T + group.rho[:, None] * T[:3, 3]
        start, scale = camera.project(q), 1.0 / np.maximum(q[:, 2], 1e-6)
        slope = np.column_stack(
            [camera.fx * (T[0, 3] - q[:, 0] * scale * T[2, 3]) * scale, camera.fy * (T[1, 3] - q[:, 1] * scale * T[2, 3]) * scale]
        )  # d(u, v)/d rho
        length = np.maximum(np.hypot(slope[:, 0], slope[:, 1]), 1e-12)
        reach = np.minimum(length * DEPTH_DOUBT_PX / self.rig.bf, MAX_REACH_PX)
        start[(scale < 0.5) | (scale > 3.0)] = np.nan
        found = matched(group.left, target, group.pixels, start, scale, slope / length[:, None], reach)
        return within(found, TARGET_RMS * group.limit)

    def _match_right(
        self, group: MatchGroup, T: FloatArray, in_left: FloatArray, target_right: NDArray[np.float32], pair: PosedPair
    ) -> FloatArray:
        """(n, 2) px of the points in a target's right image, for those with a match in_left (n, 2) px."""
        z = (self.rig.camera.rays(group.pixels.astype(float)) @ T[:3, :3].T)[:, 2] + group.rho * T[2, 3]
        scale = 1.0 / np.maximum(z, 1e-6)
        disparity = self.rig.bf * group.rho * scale + pair.disparity_bias
        start = pair.right_rectifier.real_pixels(in_left - np.column_stack([disparity, np.zeros(len(disparity))]))
        return within(matched(group.left, target_right, group.pixels, start, scale), TARGET_RMS * group.limit)

    def _close(self, group: MatchGroup) -> None:
        """Keep the group if it has a target; where there are too many, every second goes and the next come half as often."""
        self.open = None
        if not group.targets:
            return
        group.left = np.zeros((0, 0), np.float32)
        self.finished.append(group)
        if len(self.finished) > MOST_GROUPS:
            del self.finished[1::2]
            self.stride *= 2

    def observations(self, log: DriveLog) -> CalibrationObservations:
        """What was gathered of this log."""
        S, done = len(self.finished), self.finished
        frames, T = np.full((S, TARGETS), -1, np.int32), np.tile(np.eye(4), (S, TARGETS, 1, 1))
        columns: list[tuple[FloatArray, ...]] = [(np.zeros((0, 2)), np.zeros((0, 2)), *(2 * [np.zeros((0, TARGETS, 2))]))]
        for s, group in enumerate(done):
            matches = np.full((2, len(group.pixels), TARGETS, 2), np.nan)
            for t, (frame, T_target_host, in_left, in_right) in enumerate(group.targets):
                frames[s, t], T[s, t], matches[0, :, t], matches[1, :, t] = frame, T_target_host, in_left, in_right
            columns.append((group.pixels.astype(float), group.uv_right, matches[0], matches[1]))
        pixels, right, left_target, right_target = (np.concatenate(column) for column in zip(*columns, strict=True))
        return CalibrationObservations(
            drive_name(log), log.rig_id, self.rig, np.array([s.frame for s in done], np.int32), frames, T,
            np.repeat(np.arange(S, dtype=np.int32), [len(s.pixels) for s in done]), pixels.astype(np.int32),
            right.astype(np.float32), left_target.astype(np.float32), right_target.astype(np.float32),
        )  # fmt: skip


def smoothed(image: Image) -> NDArray[np.float32]:
    """(h, w) uint8 to float32, smoothed so that interpolation errs by under a hundredth of a pixel."""
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, SMOOTHING, SMOOTHING), np.float32)


def matched(
    host: NDArray[np.float32],
    target: NDArray[np.float32],
    pixels: NDArray[np.int64],
    start: FloatArray,
    scale: FloatArray,
    directions: FloatArray | None = None,
    reach: FloatArray | None = None,
) -> FloatArray:
    """(n, 3) of the patches around pixels (n, 2) of host (h, w) in target (h, w): u, v in px, the rms residual in grey levels; NaN
    where they are not found.

    start (n, 2) px; scale (n,); first searched within +-reach (n,) px along directions (n, 2).
    """
    n, out = len(pixels), np.empty((len(pixels), 3))
    directions, reach = (np.zeros((n, 2)), np.zeros(n)) if directions is None or reach is None else (directions, reach)
    match_patches(host, target, pixels, start, scale, directions, reach, MIN_EIGENVALUE, out)
    return out


def within(found: FloatArray, limit: float) -> FloatArray:
    """(n, 2) px of what `matched` found (n, 3), NaN where the rms residual is larger than the limit."""
    return np.where(found[:, 2:] <= limit, found[:, :2], np.nan)
