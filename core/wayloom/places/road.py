"""Road travelled by a drive's keyframes, and choice of keyframes by it."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def road_m(T_world_cam: FloatArray) -> FloatArray:
    """(K,) m of road from the first of the cameras (K, 4, 4) to each."""
    steps = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def spaced(road: FloatArray, segment: NDArray[np.int32], spacing_m: float) -> NDArray[np.bool_]:
    """(K,) which keyframes to take so that of each segment the first is and the next ones are at least so far apart."""
    chosen = np.zeros(len(road), bool)
    last, of = -np.inf, -1
    for k, (at, number) in enumerate(zip(road.tolist(), segment.tolist(), strict=True)):
        if number != of or at - last >= spacing_m:
            chosen[k], last, of = True, at, number
    return chosen
