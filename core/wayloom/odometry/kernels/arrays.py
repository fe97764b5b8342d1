"""Data types of the kernels: named tuples of arrays. Frames of the window count from 0 to F-1, oldest first; N live points."""

from typing import NamedTuple

import numpy as np

PATTERN = np.array([[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], np.int64)
"""(8, 2) offsets (x, y) in px of a patch's pixels from its centre (Engel et al. 2018, fig. 4)."""
PATCH = 8
LOCAL = 9
"""Unknowns of a (host, target) pair: target twist relative to the host (6), a, b, disparity bias."""

RIGHT, LEFT_ALIKE, RIGHT_ALIKE = 1, 2, 4
"""What is noted of an observation, summed: the patch is a photometric inlier in the right image as well as in the left one, by
which points are kept; it looks like its host in the left image, and in the right one, by which labels are asked for."""
LEAST_ALIKE = 0.8
"""The correlation of a patch with its host's from which on it looks like it."""


class Rig(NamedTuple):
    """Intrinsics of both images in px and t_right_left in m: p_right = p_left + t."""

    fx: float
    fy: float
    cx: float
    cy: float
    tx: float
    ty: float
    tz: float


class Images(NamedTuple):
    """left, right (slots, h, w) uint8: the images of the window's keyframes; the right ones with their rows corrected."""

    left: np.ndarray
    right: np.ndarray


class Frames(NamedTuple):
    """The keyframes of the window.

    slot (F,) place in Images; T_cam_world, T_first (F, 4, 4) current and first estimate; has_first (F,) 1 once a prior holds the
    frame to its first estimate (2: the same, but Jacobians are taken at the current one); affine, affine_first (F, 2) a and b of
    I = exp(a) I_scene + b; gain_right (F, 2) right = gain left + offset.
    """

    slot: np.ndarray
    T_cam_world: np.ndarray
    T_first: np.ndarray
    has_first: np.ndarray
    affine: np.ndarray
    affine_first: np.ndarray
    gain_right: np.ndarray


class PointColumns(NamedTuple):
    """The live points.

    host (N,) index into Frames; uv (N, 2) px in the host; rho (N,) inverse depth 1/m; colour, weight (N, 8) float32 grey levels of
    the host's patch and gradient weights; has_static (N,) 1 while the host's right image is used;
    closed (N, capacity) 1 where the point has no residual in that frame any more.
    """

    host: np.ndarray
    uv: np.ndarray
    rho: np.ndarray
    colour: np.ndarray
    weight: np.ndarray
    has_static: np.ndarray
    closed: np.ndarray


class Robust(NamedTuple):
    """huber: grey levels; max_energy: grey^2 a pixel, of a patch, above which it is an outlier; static_weight: the coupling lambda
    of the host's right image; observer_right_weight: the same for the observers' right images, 0 switches them off."""

    huber: float
    max_energy: float
    static_weight: float
    observer_right_weight: float


class Scratch(NamedTuple):
    """Working space of one residual: M (4, 4, upper) and e (4,) are a patch's sums, J (2, 8) the projection's Jacobian; the rest
    are columns of 8, one number a pixel: words (32,) int32 the 4 x 4 pixels around each, columns (72,) float32."""

    M: np.ndarray
    e: np.ndarray
    J: np.ndarray
    words: np.ndarray
    columns: np.ndarray


class Terms(NamedTuple):
    """All residuals of a window, linearised. Pair (h, h) holds the static terms of host h, which know the bias only.

    H_pair (F, F, 9, 9) lower = J^T W J and g_pair (F, F, 9) = -J^T W r, by [host, target], in the pair's local unknowns;
    coupling (N, F, 9) = J_rho^T W J; own (N, 2) = J_rho^T W J_rho and -J_rho^T W r;
    inlier (N, F + 1) 1 where the patch is an inlier in that frame's left image, last column: in the host's right image.
    """

    H_pair: np.ndarray
    g_pair: np.ndarray
    coupling: np.ndarray
    own: np.ndarray
    inlier: np.ndarray
