"""Recovery of frames that the predicted motion does not explain, and the tests by which an alignment is believed or lost.

A doubtful frame is looked for with more and more effort: other motions, features of the newest keyframe, features of older ones, a
grid of turns. What is found must fit the images and must be possible. Being lost is an outcome that is reported, never a crash.
Ordinary frames are aligned once and leave here after a few comparisons.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.arrays import Rig
from wayloom.odometry.kernels.linear import log_se3, relative
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking import pyramid, relocalisation
from wayloom.odometry.tracking.alignment import Alignment, Reference, align, best_alignment, further_guesses, make_reference
from wayloom.odometry.tracking.frame import Frame

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
ALWAYS_BELIEVED_M = 0.3
MAX_SPEED_M_S = 90.0
WORSE_THAN_USUAL = 1.5
SATURATED, GRAVELY_SATURATED, LONG_GAP_S = 0.15, 0.3, 0.45
"""Shares of the points in view beyond the cut-off, from which other motions are tried and from which features are looked for; and
seconds without a tracked frame, after which both happen whatever the fit."""
WELL_SEEN, MANY_POINTS = 0.6, 100
"""Share and number of the keyframe's points that the first frame with a motion sees where its place needs no features: wrong places
that fit as well saw a third of them, or a few dozen (decision 119)."""
GRID_TURNS_RAD = (-0.32, -0.22, -0.14, -0.08, 0.08, 0.14, 0.22, 0.32)
GRID_WAYS = (0.0, 1.0, 2.0)
GRID_KEPT = 4
OLDER_KEYFRAMES = 3
"""Keyframes before the newest in which features are looked for."""
TRUSTED_WAY_M, TRUSTED_WAY_SHARE, TRUSTED_TURN_RAD = 0.3, 0.05, 0.02
MANY_FEATURES, VISIBLE_BESIDE_FEATURES = 35, 0.05
"""So many features vouch for a place from which no more than this share of the reference is seen."""
USUAL_GAIN, GAIN_RATIO = 2.0, 2.5


@dataclass(frozen=True, slots=True)
class TrackingRequest:
    """A new frame before its pose is known.

    frame        its images and predicted pose
    T_last, T_tracked  (4, 4) T_cam_world of the frame before it, and of the last one that was tracked
    dt_s         seconds since the frame before, since_s since the last tracked one
    follows_held  whether frames were held in between
    starting     whether no motion is known yet
    brightness   (2,) gain, offset against the newest keyframe, as last estimated
    usual_rms    grey levels, of alignments so far; infinite before the first
    """

    frame: Frame
    T_last: FloatArray
    T_tracked: FloatArray
    dt_s: float
    since_s: float
    follows_held: bool
    starting: bool
    brightness: FloatArray
    usual_rms: float


@dataclass(frozen=True, slots=True)
class TrackingResult:
    """The alignment chosen, and how it was found.

    fit       the alignment
    keyframe  of the window, with which the frame was aligned: its row in the result
    failure   why the alignment is not believed, in words; None where it is
    tried     number of motions tried
    features  number of matched features that agree with it; 0 where none were asked
    """

    fit: Alignment
    keyframe: int
    failure: str | None
    tried: int = 1
    features: int = 0


def is_blank(image: Image, min_contrast: float) -> bool:
    """Whether an image (h, w) shows nothing: black, white, or grey all over. Looks at every fourth row."""
    return contrast_of(image) < min_contrast


def contrast_of(image: Image) -> float:
    """Standard deviation of an image (h, w), in grey levels, by every fourth row."""
    return float(cv2.meanStdDev(image[::4])[1][0, 0])


def fits_badly(fit: Alignment, usual_rms: float, settings: OdometrySettings) -> bool:
    """Whether a good part of the image does not agree with the alignment."""
    return not fit.rms <= WORSE_THAN_USUAL * usual_rms or fit.visible < settings.min_visible or fit.saturated > SATURATED


def is_doubtful(fit: Alignment, request: TrackingRequest, settings: OdometrySettings) -> bool:
    """Whether other motions should be tried beside the one that gave this alignment."""
    return request.starting or request.since_s > LONG_GAP_S or fits_badly(fit, request.usual_rms, settings)


def fit_failure(fit: Alignment, settings: OdometrySettings, min_visible: float | None = None) -> str | None:
    """Why an alignment cannot be right, in words, or None. min_visible : share of the reference; default is the settings'."""
    if not (np.isfinite(fit.T_frame_keyframe).all() and np.isfinite(fit.brightness).all() and math.isfinite(fit.rms)):
        return "the alignment is not finite"
    if fit.visible < (settings.min_visible if min_visible is None else min_visible):
        return f"{100 * fit.visible:.0f} % of the keyframe's points are in view"
    if fit.saturated > settings.max_saturated:
        return f"{100 * fit.saturated:.0f} % of the points fit worse than {settings.cutoff:g} grey levels"
    if fit.rms > math.sqrt(settings.huber * (2.0 * settings.cutoff - settings.huber)):  # that of points at the cut-off
        return f"the points fit to {fit.rms:.0f} grey levels only"
    if not 1.0 / settings.max_gain < fit.brightness[0] < settings.max_gain:
        return f"the image is {fit.brightness[0]:.2g} times as bright as the keyframe"
    return None


def sees_much(fit: Alignment, reference: Reference) -> bool:
    """Whether enough of the reference is in view that a place that fits cannot be chance."""
    return fit.visible >= WELL_SEEN and fit.visible * len(reference.levels[0]) >= MANY_POINTS


def motion_failure(
    T_cam_world: FloatArray, T_last: FloatArray, T_predicted: FloatArray | None, dt_s: float, settings: OdometrySettings
) -> str | None:
    """Why a motion cannot be real, in words, or None.

    T_cam_world (4, 4) of the frame, of the last tracked one dt_s seconds before, and by constant motion: None where that need not
    be true
    """
    motion = log_se3(relative(T_cam_world, T_last))
    way, turn = float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:]))
    if turn > settings.max_turn_rate * dt_s + 0.05:
        return f"a turn of {math.degrees(turn):.1f} deg in {dt_s:.2f} s"
    if way > MAX_SPEED_M_S * dt_s + ALWAYS_BELIEVED_M:
        return f"a way of {way:.2f} m in {dt_s:.2f} s"
    if T_predicted is None:
        return None
    surprise = float(np.linalg.norm(se3.inverse(T_cam_world)[:3, 3] - se3.inverse(T_predicted)[:3, 3]))
    if surprise > settings.max_acceleration * dt_s**2 + ALWAYS_BELIEVED_M + 0.2 * way:
        return f"{surprise:.2f} m from where constant motion leads"
    return None


def gain_failure(fit: Alignment, image: Image, keyframe: Image) -> str | None:
    """Why a change of brightness cannot be real, or None: an alignment that lost its way explains everything by one flat grey.

    Looks at the images (h, w) only where the gain is unusual: their contrast must have changed about as much.
    """
    gain = float(fit.brightness[0])
    if 1.0 / USUAL_GAIN < gain < USUAL_GAIN:
        return None
    contrast = max(contrast_of(image), 1e-3) / max(contrast_of(keyframe), 1e-3)
    if contrast / GAIN_RATIO < gain < contrast * GAIN_RATIO:
        return None
    return f"the image is {gain:.2g} times as bright as the keyframe, its contrast {contrast:.2g} times"


def gap_failure(fit: Alignment, since_s: float, follows_held: bool) -> str | None:
    """Why an alignment that no features vouch for is not believed since_s seconds after the last place, or None: after frames that
    were held, or a long gap, the vehicle may be anywhere, and what does not fit need not be a bus that passes."""
    if not (follows_held or since_s > LONG_GAP_S) or fit.saturated <= GRAVELY_SATURATED:
        return None
    return f"after {since_s:.1f} s without a place {100 * fit.saturated:.0f} % of the points do not fit, and no features do"


def turned_guesses(T_predicted: FloatArray, T_last: FloatArray) -> list[FloatArray]:
    """T_cam_world (4, 4) of a grid: left and right turns with no, the expected and twice the expected way."""
    twist = se3.log(T_predicted @ se3.inverse(T_last))
    ways = [se3.exp(twist * share) @ T_last for share in GRID_WAYS]
    return [np.asarray(se3.exp(np.array([0, 0, 0, 0, yaw, 0.0])) @ T) for yaw in GRID_TURNS_RAD for T in ways]


class Recovery:
    """Aligns frames with the window. It keeps the features of the window's last keyframes between lost frames, and nothing else."""

    def __init__(self, settings: OdometrySettings, stereo_rig: StereoRig, rig: Rig, cameras: list[FloatArray]) -> None:
        self.settings, self.stereo_rig, self.rig, self.cameras = settings, stereo_rig, rig, cameras
        self.landmarks: dict[tuple[int, int], relocalisation.Landmarks] = {}

    def align(self, request: TrackingRequest, references: list[Reference], window: Window) -> TrackingResult:
        """The frame's alignment with the newest keyframe by constant motion, where that fits; else the best that can be found.

        references : of the newest keyframes, newest last
        """
        newest, T_world_newest = references[-1], _T_world_keyframe(window, references[-1].keyframe)
        fit = self._aligned(request, newest, request.frame.T_predicted @ T_world_newest, request.brightness)
        if not self._in_question(fit, newest.keyframe, request, window):
            return TrackingResult(fit, newest.keyframe, None)
        return self._search(fit, request, references, window)

    def _search(self, fit: Alignment, request: TrackingRequest, references: list[Reference], window: Window) -> TrackingResult:
        """Other motions, then features, then a grid of turns, until one fits and is possible."""
        s, newest = self.settings, references[-1]
        T_world_newest = _T_world_keyframe(window, newest.keyframe)
        guesses = further_guesses(
            request.frame.T_predicted, request.T_last, se3.inverse(T_world_newest), request.dt_s, request.starting
        )
        fit = best_alignment(request.frame.images, newest, guesses, request.brightness, fit, T_world_newest, self.cameras, s)
        failure, tried = self._failure(fit, newest.keyframe, request, window), 1 + len(guesses)
        best = TrackingResult(fit, newest.keyframe, failure, tried)
        uncertain = request.since_s > LONG_GAP_S or fit.saturated > (SATURATED if request.starting else GRAVELY_SATURATED)
        expected = sees_much(fit, newest) if request.starting else not self._surprises(fit, newest.keyframe, request, window)
        if failure is None and not uncertain and expected:
            return best
        decided = False
        for shrink in relocalisation.shrinks(request.frame.left):
            seen = relocalisation.find_features(request.frame.left, shrink)
            for index in self._candidates(window)[: 1 if failure is None else None]:
                result = self._by_features(index, seen, shrink, request, references, window)
                if result is not None and (failure is not None or result.fit.rms < fit.rms):
                    return TrackingResult(result.fit, result.keyframe, None, tried + 1, result.features)
                decided = decided or result is not None
            if decided:  # features of larger images would lead there, too
                break
        failure = failure or gap_failure(fit, request.since_s, request.follows_held)
        if failure is None:
            return best
        grid = self._best_of_grid(request, newest, T_world_newest)
        fit = best_alignment(request.frame.images, newest, grid, request.brightness, fit, T_world_newest, self.cameras, s)
        failure = self._failure(fit, newest.keyframe, request, window) or gap_failure(fit, request.since_s, request.follows_held)
        return TrackingResult(fit, newest.keyframe, failure, tried + len(GRID_TURNS_RAD) * len(GRID_WAYS))

    def _aligned(
        self, request: TrackingRequest, reference: Reference, T_frame_keyframe: FloatArray, brightness: FloatArray
    ) -> Alignment:
        return align(
            request.frame.images, reference, T_frame_keyframe, brightness, self.cameras, len(self.cameras) - 1, 0, self.settings
        )  # fmt: skip

    def _failure(
        self, fit: Alignment, keyframe: int, request: TrackingRequest, window: Window, min_visible: float | None = None
    ) -> str | None:
        """Why an alignment cannot be believed, or None. A motion that does not go on as it was is believed where the whole image
        agrees: half an image may be a bus that passes."""
        failure = fit_failure(fit, self.settings, min_visible)
        index = window.index_of(keyframe)
        failure = failure or gain_failure(fit, request.frame.left, window.images.left[window.frames.slot[index]])
        if failure is not None:
            return failure
        free = request.starting or not fits_badly(fit, request.usual_rms, self.settings)
        T_cam_world, dt_s = fit.T_frame_keyframe @ window.frames.T_cam_world[index], max(request.since_s, request.dt_s)
        return motion_failure(T_cam_world, request.T_tracked, None if free else request.frame.T_predicted, dt_s, self.settings)

    def _in_question(self, fit: Alignment, keyframe: int, request: TrackingRequest, window: Window) -> bool:
        """Whether more should be tried: the alignment fits badly, cannot be believed, or leads elsewhere than the motion so far."""
        if is_doubtful(fit, request, self.settings) or fit_failure(fit, self.settings) is not None:
            return True
        keyframe_image = window.images.left[window.frames.slot[window.index_of(keyframe)]]
        return gain_failure(fit, request.frame.left, keyframe_image) is not None or self._surprises(fit, keyframe, request, window)

    def _surprises(self, fit: Alignment, keyframe: int, request: TrackingRequest, window: Window) -> bool:
        """Whether an alignment, right or not, leads away from where constant motion does."""
        T_cam_world, dt_s = fit.T_frame_keyframe @ window.frames.T_cam_world[window.index_of(keyframe)], request.since_s
        return (
            motion_failure(T_cam_world, request.T_tracked, request.frame.T_predicted, max(dt_s, request.dt_s), self.settings)
            is not None
        )

    def _candidates(self, window: Window) -> range:
        """Places in the window of the keyframes to be looked for, newest first; features of others are forgotten."""
        self.landmarks = {key: known for key, known in self.landmarks.items() if key[0] in window.keyframe}
        return range(len(window) - 1, max(-1, len(window) - 2 - OLDER_KEYFRAMES), -1)

    def _by_features(
        self, index: int, seen: relocalisation.Features, shrink: int, request: TrackingRequest, references: list[Reference],
        window: Window,
    ) -> TrackingResult | None:  # fmt: skip
        """The alignment with keyframe `index` of the window to which features lead, of images made `shrink` times smaller; None
        where it fails or leads elsewhere."""
        row, slot = int(window.keyframe[index]), window.frames.slot[index]
        if (row, shrink) not in self.landmarks:
            left, right = window.images.left[slot], window.images.right[slot]
            self.landmarks[row, shrink] = relocalisation.landmarks(
                left, right, self.stereo_rig, float(window.disparity_bias[0]), self.settings, shrink
            )
        sighting = relocalisation.sight(self.landmarks[row, shrink], seen, self.stereo_rig.camera.K)
        if sighting is None or not sighting.decisive:
            return None
        reference = next((r for r in references if r.keyframe == row), None) or self._reference(window, index)
        top = min(2, len(self.cameras) - 1)
        fit = align(
            request.frame.images, reference, sighting.T_frame_keyframe, sighting.brightness, self.cameras, top, 0, self.settings
        )  # fmt: skip
        min_visible = VISIBLE_BESIDE_FEATURES if sighting.inliers >= MANY_FEATURES else None
        if self._failure(fit, row, request, window, min_visible) is not None or not _agree(fit, sighting):
            return None
        return TrackingResult(fit, row, None, 1, sighting.inliers)

    def _reference(self, window: Window, index: int) -> Reference:
        """What frames are aligned with, of a keyframe that is no longer one of the newest."""
        images = pyramid.build(window.images.left[window.frames.slot[index]], len(self.cameras))
        return make_reference(window, index, images, self.cameras, self.rig, self.settings.border)

    def _best_of_grid(self, request: TrackingRequest, reference: Reference, T_world_keyframe: FloatArray) -> list[FloatArray]:
        """The turned guesses that fit best on the coarsest levels, T_cam_world (4, 4) each."""
        top = len(self.cameras) - 1
        fits: list[tuple[float, int, FloatArray]] = []
        for T_guess in turned_guesses(request.frame.T_predicted, request.T_last):
            T = T_guess @ T_world_keyframe
            coarse = align(
                request.frame.images, reference, T, request.brightness, self.cameras, top, max(top - 1, 0), self.settings
            )
            if fit_failure(coarse, self.settings) is None:
                fits.append((coarse.rms, len(fits), coarse.T_frame_keyframe @ se3.inverse(T_world_keyframe)))
        return [T for _, _, T in sorted(fits, key=lambda item: item[:2])[:GRID_KEPT]]


def _agree(fit: Alignment, sighting: relocalisation.Sighting) -> bool:
    """Whether the direct alignment stayed where the features led it."""
    difference = se3.log(fit.T_frame_keyframe @ se3.inverse(sighting.T_frame_keyframe))
    way = float(np.linalg.norm(sighting.T_frame_keyframe[:3, 3]))
    near = float(np.linalg.norm(difference[:3])) < TRUSTED_WAY_M + TRUSTED_WAY_SHARE * way
    return near and float(np.linalg.norm(difference[3:])) < TRUSTED_TURN_RAD


def _T_world_keyframe(window: Window, keyframe: int) -> FloatArray:
    """(4, 4) of a keyframe in the window by its row in the result."""
    return np.asarray(se3.inverse(window.frames.T_cam_world[window.index_of(keyframe)]))
