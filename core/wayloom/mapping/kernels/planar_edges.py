"""Edges of a pose graph in the plane, poses (x, y, heading): errors and Jacobians.

The error of an edge with measurement z is e = (R_z^T (R_first^T (t_second - t_first) - t_z), heading), as in g2o and
gtsam: the step between the poses,
seen from the measured one. Poses are perturbed on the right: t <- t + R (dx, dy), heading <- heading + d.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def fill_errors(poses: FloatArray, first: IntArray, second: IntArray, measured: FloatArray, errors: FloatArray) -> None:
    """errors (E, 3) of measured (E, 3), between nodes first and second (E,) of poses (N, 3)."""
    for e in range(len(first)):
        a, b, z = poses[first[e]], poses[second[e]], measured[e]
        c, s = np.cos(a[2]), np.sin(a[2])
        dx, dy = b[0] - a[0], b[1] - a[1]
        x, y = c * dx + s * dy - z[0], -s * dx + c * dy - z[1]
        c, s = np.cos(z[2]), np.sin(z[2])
        errors[e, 0], errors[e, 1] = c * x + s * y, -s * x + c * y
        turn = b[2] - a[2] - z[2]
        errors[e, 2] = np.arctan2(np.sin(turn), np.cos(turn))


@njit(cache=True, error_model="numpy")
def fill_jacobians(
    poses: FloatArray,
    first: IntArray,
    second: IntArray,
    measured: FloatArray,
    errors: FloatArray,
    by_first: FloatArray,
    by_second: FloatArray,
) -> None:
    """by_first and by_second (E, 3, 3) of errors (E, 3), between nodes first and second (E,) of poses (N, 3)."""
    for e in range(len(first)):
        fill_edge_jacobians(poses[first[e]], poses[second[e]], measured[e], by_first[e], by_second[e])


@njit(cache=True, error_model="numpy")
def fill_edge_jacobians(a: FloatArray, b: FloatArray, measured: FloatArray, by_first: FloatArray, by_second: FloatArray) -> None:
    """Of an edge's error (3,) by its poses a and b (3,), perturbed on the right: (3, 3) each."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = c * dx + s * dy, -s * dx + c * dy
    cz, sz = np.cos(measured[2]), np.sin(measured[2])
    by_first[:] = 0.0
    by_first[0, 0], by_first[0, 1] = -cz, -sz
    by_first[1, 0], by_first[1, 1] = sz, -cz
    by_first[0, 2], by_first[1, 2] = cz * y - sz * x, -sz * y - cz * x
    by_first[2, 2] = -1.0
    turn = b[2] - a[2] - measured[2]
    c, s = np.cos(turn), np.sin(turn)
    by_second[:] = 0.0
    by_second[0, 0], by_second[0, 1] = c, -s
    by_second[1, 0], by_second[1, 1] = s, c
    by_second[2, 2] = 1.0
