"""Association of left and right images by their time stamps."""

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
SYNC_SHARE, SYNC_NS = 0.25, 5_000_000
"""Images belong together whose stamps differ by at most this share of the usual step, and this."""


def taken_together(left_ns: IntArray, right_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Rows of left_ns (N,) and right_ns (M,), both rising, whose images were taken at one time, (K,) each: every left image with
    the nearest right one, where that is near enough."""
    if not len(left_ns) or not len(right_ns):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    step = float(np.median(np.diff(left_ns))) if len(left_ns) > 1 else np.inf
    after = np.clip(np.searchsorted(right_ns, left_ns), 1, max(len(right_ns) - 1, 1))
    within = np.minimum(after, len(right_ns) - 1)
    near = np.where(np.abs(right_ns[within] - left_ns) < np.abs(right_ns[after - 1] - left_ns), within, after - 1)
    fits = np.abs(right_ns[near] - left_ns) <= min(SYNC_SHARE * step, SYNC_NS)
    return np.flatnonzero(fits).astype(np.int64), near[fits].astype(np.int64)
