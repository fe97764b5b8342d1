"""Standard deviations along rays that do not know the error of the very point.

Stereo measures inverse depth, so that a point's sigma grows with the square of its depth: a point that is measured too near claims
to be surer than one that is measured too far. Weighted by its own claim, a surface comes nearer to its cameras, by
4 sigma^2 / depth: decimetres where images are small. Here sigma is taken at the depth that points beside it in the image have.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
HALF_WINDOW: Final = 4
"""Points to either side, by bearing, of the same camera and group."""


def sigmas_beside(rays: FloatArray, sigma_m: FloatArray, camera: NDArray[np.int32], group: NDArray[np.int8]) -> FloatArray:
    """(N,) m: sigma along each of the rays (N, 3) m, at the mean inverse length of those beside it.

    camera, group : (N,) rays of one camera and one group count as beside each other, by their bearing
    """
    length = np.maximum(np.linalg.norm(rays, axis=1), 1e-3)
    order = np.lexsort((np.arctan2(rays[:, 1], rays[:, 0]), group, camera))
    key = camera[order].astype(np.int64) * 256 + group[order]
    first, last = np.searchsorted(key, key, side="left"), np.searchsorted(key, key, side="right")
    at = np.arange(len(order))
    low, high = np.maximum(at - HALF_WINDOW, first), np.minimum(at + HALF_WINDOW + 1, last)
    total = np.concatenate([[0.0], np.cumsum(1.0 / length[order])])
    beside = np.empty(len(order))
    beside[order] = (total[high] - total[low]) / (high - low)
    return np.asarray(sigma_m / (length * beside) ** 2)
