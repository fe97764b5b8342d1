"""Static stereo matching at a keyframe, and the brightness of the right image against the left one."""

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.kernels.stereo import match_rows, sobel_rows

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]


def capped_slope(image: Image, cap: int) -> NDArray[np.int16]:
    """(h, w) uint8 to int16: horizontal Sobel / 4 capped to +-cap, 0 at the border. Stereo on it needs no left-right gain."""
    out = np.empty(image.shape, np.int16)
    sobel_rows(image, 4 * cap, out)
    return out


def match(
    left: Image, right: Image, pixels: NDArray[np.int64], max_disparity: int, uniqueness: float, max_cost: float, slope_cap: int
) -> FloatArray:
    """Disparity and its sigma, px, (n, 2), of left pixels (n, 2); sigma is 1e9 for a pixel without a sure match."""
    out = np.empty((len(pixels), 2))
    slopes = capped_slope(left, slope_cap), capped_slope(right, slope_cap)
    match_rows(*slopes, left, right, pixels, min(max_disparity, left.shape[1] // 2), uniqueness, max_cost, out)
    return out


def right_gain(left: Image, right: Image, pixels: NDArray[np.int64], disparity: FloatArray) -> FloatArray:
    """(2,) gain, offset with right = gain left + offset over matched pixels (n, 2), robust; (1, 0) under 20 matches.

    The right image's own a, b follow: a_right = a + log gain, b_right = gain b + offset. They are unknowns of this keyframe's pair
    alone, so they are solved from the pair once instead of being carried through the window.
    """
    if len(pixels) < 20:
        return np.array([1.0, 0.0])
    u, v = pixels.T
    x = np.clip(u - disparity, 0, right.shape[1] - 2)
    ix = x.astype(int)
    values = (1 - x + ix) * right[v, ix] + (x - ix) * right[v, ix + 1]
    grey = left[v, u].astype(float)
    weight, gain, offset = np.ones(len(x)), 1.0, 0.0
    for _ in range(5):
        total = weight.sum()
        mean_left, mean_right = (weight * grey).sum() / total, (weight * values).sum() / total
        spread = (weight * (grey - mean_left) ** 2).sum()
        gain = ((weight * (grey - mean_left) * (values - mean_right)).sum() + 100.0) / (spread + 100.0)
        offset = mean_right - gain * mean_left
        weight = 4.0 / np.maximum(np.abs(gain * grey + offset - values), 4.0)
    return np.array([np.clip(gain, 0.2, 5.0), offset])
