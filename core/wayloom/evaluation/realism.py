"""Image statistics of real and simulated stereo pairs: power spectra, gradients, stereo residuals.

Nothing here knows where an image comes from. The stereo matches are the odometry's own, after it has re-aligned the rows, so that
a real rig's calibration errors do not count as a difference of brightness.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.odometry.points import selection, stereo
from wayloom.odometry.rig import rows
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking import pyramid

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Pair = tuple[Image, Image]

WINDOW_PX = 256
"""Edge of the windows whose power spectra are averaged."""
LOWEST, HIGH_FROM, HIGHEST = 0.01, 0.15, 0.45
"""Frequencies of the fits, cycles a pixel: all, and the fine detail alone; beyond HIGHEST aliases and noise rule."""
STRONG_GRADIENT = 7.0
PATTERN = ((0, 0), (-2, 0), (2, 0), (0, -2), (0, 2), (-1, -1), (1, -1), (-1, 1))
"""du, dv px of the pixels that are compared around a match."""
CANDIDATE_CELL_PX = 10


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """Statistics of a set of stereo pairs.

    slope, high_slope   of log power over log frequency, over all frequencies and above HIGH_FROM cycles a pixel
    strong_gradients    share of pixels whose grey value changes by more than STRONG_GRADIENT a pixel
    stereo_density      share of the odometry's candidate pixels that find a sure match in the right image
    residual            median |difference| of left and right around those matches after gain and offset, grey levels
    """

    pairs: int
    slope: float
    high_slope: float
    strong_gradients: float
    stereo_density: float
    residual: float

    def as_json(self) -> dict[str, float]:
        """The numbers by name."""
        return asdict(self)


def image_statistics(pairs: Iterable[Pair], rig: StereoRig, settings: OdometrySettings = OdometrySettings()) -> ImageStatistics:
    """Statistics of stereo pairs of (h, w) or (h, w, 3) RGB uint8 images of one rig. Raises ValueError without a pair.

    The rows of left and right are aligned from the matches of all pairs, as the odometry does it from a few.
    """
    grey = [(pyramid.grey(left), pyramid.grey(right)) for left, right in pairs]
    if not grey:
        raise ValueError("no pair to measure")
    aligned = align_rows(grey, rig)
    slope, high_slope = spectrum_slopes([left for left, _ in grey])
    found = [stereo_residuals(left, right, settings) for left, right in aligned]
    return ImageStatistics(
        len(grey),
        slope,
        high_slope,
        float(np.mean([share_of_strong_gradients(left) for left, _ in grey])),
        float(np.mean([density for density, _ in found])),
        float(np.median(np.concatenate([residuals for _, residuals in found]))),
    )


def align_rows(pairs: list[Pair], rig: StereoRig) -> list[Pair]:
    """The pairs (h, w) with the right images' rows on the left ones'."""
    matches = np.concatenate([rows.row_matches(left, right) for left, right in pairs])
    corners = rows.displacements(rows.fit(matches, rig), rig)
    return [(left, rows.align(right, corners)) for left, right in pairs]


def spectrum_slopes(images: list[Image]) -> tuple[float, float]:
    """Slope of log mean power over log frequency of images (h, w), over all frequencies and over the high ones.

    Windows of WINDOW_PX that overlap by half, weighted by a Hann window; the power at each frequency is averaged over all windows
    and directions, then fitted by a line through bins that are even on the logarithmic scale.
    """
    hann = np.hanning(WINDOW_PX)
    taper = np.outer(hann, hann)
    power, count = np.zeros((WINDOW_PX, WINDOW_PX)), 0
    for image in images:
        for window in _windows(image):
            power += np.abs(np.fft.fft2((window - window.mean()) * taper)) ** 2
            count += 1
    if not count:
        raise ValueError(f"images must be {WINDOW_PX} px wide and high at least")
    f = np.hypot(np.fft.fftfreq(WINDOW_PX)[:, None], np.fft.fftfreq(WINDOW_PX)[None])
    return _log_slope(f, power / count, LOWEST), _log_slope(f, power / count, HIGH_FROM)


def _windows(image: Image) -> Iterable[FloatArray]:
    height, width = image.shape
    for y in _starts(height):
        for x in _starts(width):
            yield image[y : y + WINDOW_PX, x : x + WINDOW_PX].astype(float)


def _starts(length: int) -> list[int]:
    if length < WINDOW_PX:
        return []
    steps = max(1, round(2 * (length - WINDOW_PX) / WINDOW_PX))
    return sorted({round(k * (length - WINDOW_PX) / steps) for k in range(steps + 1)})


def _log_slope(f: FloatArray, power: FloatArray, lowest: float) -> float:
    edges = np.geomspace(lowest, HIGHEST, 17)
    which = np.digitize(f.ravel(), edges) - 1
    x, y = [], []
    for k in range(len(edges) - 1):
        mine = which == k
        if mine.any():
            x.append(np.log(f.ravel()[mine].mean()))
            y.append(np.log(power.ravel()[mine].mean()))
    return float(np.polyfit(x, y, 1)[0])


def share_of_strong_gradients(image: Image) -> float:
    """Share of pixels of an image (h, w) whose central differences are longer than STRONG_GRADIENT grey levels a pixel."""
    x = image.astype(np.float32)
    gx, gy = 0.5 * (x[1:-1, 2:] - x[1:-1, :-2]), 0.5 * (x[2:, 1:-1] - x[:-2, 1:-1])
    return float(np.mean(np.hypot(gx, gy) > STRONG_GRADIENT))


def stereo_residuals(left: Image, right: Image, settings: OdometrySettings) -> tuple[float, FloatArray]:
    """Share of candidate pixels of a pair (h, w) with aligned rows that match, and |left - right| around them, grey levels."""
    s = settings
    pixels = selection.select_candidates(left, np.zeros((0, 2)), CANDIDATE_CELL_PX, s.block, s.gradient_margin, s.border)
    found = stereo.match(left, right, pixels, s.max_disparity, s.uniqueness, s.max_cost, s.slope_cap)
    good = (found[:, 1] < s.max_sigma) & (found[:, 0] > s.min_disparity)
    matched, disparity = pixels[good], found[good, 0]
    gain, offset = stereo.right_gain(left, right, matched, disparity)
    u, v = (matched[:, None, :] + np.array(PATTERN)).transpose(2, 0, 1)
    x = u - disparity[:, None]
    inside = (x >= 0) & (x < right.shape[1] - 1)
    x, u, v = x[inside], u[inside], v[inside]
    column = np.floor(x).astype(int)
    share = x - column
    seen = (1 - share) * right[v, column] + share * right[v, column + 1]
    return float(good.mean()) if len(good) else 0.0, np.abs(gain * left[v, u] + offset - seen)
