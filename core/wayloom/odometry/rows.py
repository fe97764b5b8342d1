"""Left-right row misalignment: its model, its fit to stereo matches, and the remap of the right image that undoes it.

A left pixel whose match has the normalised coordinates (x, y) lies in the right image at row v + dv,
    dv = c0 (1 + y^2) + c1 x + c2 x y,
a small rotation of the right camera about x and z, and the keystone that lens errors leave. What the calibration itself says of the
rows (t_right_left y and z) is taken off the matches first. Columns are left alone: the disparity bias is an unknown of the window.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.odometry import selection, stereo
from wayloom.odometry.kernels.stereo import NO_MATCH, refine_both_axes

HALF = 5
MIN_EIGENVALUE = 30.0
RESIDUAL_SCALE_PX = 0.15
MIN_MATCHES = 60
RIDGE = 0.01  # matches' worth of pull to zero: an image without matches in its corners keeps a small keystone
Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]


def row_matches(left: Image, right: Image, max_disparity: int = 180) -> FloatArray:
    """Stereo matches of one pair (h, w) with their row offsets: (n, 4) of left u, v, disparity, dv in px."""
    pixels = selection.select_candidates(left, np.zeros((0, 2)), 8, 32, 7.0, HALF + 4)
    found = stereo.match(left, right, pixels, max_disparity, 0.85, 12.0, 60)
    good = (found[:, 1] < NO_MATCH) & (found[:, 0] > 0.5)
    pixels, disparity = pixels[good], found[good, 0]
    refined = np.zeros((len(pixels), 3))
    refine_both_axes(left, right, pixels, disparity, HALF, MIN_EIGENVALUE, refined)
    return np.column_stack([pixels, refined[:, :2]])[refined[:, 2] > 0]


def design(x: FloatArray, y: FloatArray) -> FloatArray:
    """(n, 3): derivatives of dv with respect to c0, c1, c2 at normalised coordinates x, y (n,)."""
    return np.column_stack([1.0 + y * y, x, x * y])


def known_row_offset(rig: StereoRig, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """(n,) px: what t_right_left's y and z move the rows by, at rows v and disparities (n,) px."""
    rho = disparity / rig.bf
    _, ty, tz = rig.t_right_left
    moved = ((v - rig.camera.cy) / rig.camera.fy + ty * rho) / (1.0 + tz * rho)
    return rig.camera.fy * moved + rig.camera.cy - v


def fit(matches: FloatArray, rig: StereoRig) -> FloatArray:
    """(3,) px c0, c1, c2 by Cauchy-weighted least squares with two nuisance terms in disparity; zeros under 60 matches."""
    if len(matches) < MIN_MATCHES:
        return np.zeros(3)
    u, v, disparity, dv = matches.T
    camera = rig.camera
    x, y = (u - disparity - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    d = disparity / max(float(np.max(disparity)), 1.0)
    A = np.column_stack([design(x, y), d, y * d])
    target = dv - known_row_offset(rig, v, disparity)
    weight, c = np.ones(len(x)), np.zeros(5)
    for _ in range(20):
        normal = np.einsum("ni,n,nj->ij", A, weight, A) + RIDGE * np.eye(5)
        c = np.linalg.solve(normal, np.einsum("ni,n,n->i", A, weight, target))
        weight = 1.0 / (1.0 + ((A @ c - target) / RESIDUAL_SCALE_PX) ** 2)
    return c[:3]


def maps(coefficients: FloatArray, rig: StereoRig) -> Maps:
    """Maps for cv2.remap that bring the right image's rows onto the left's."""
    camera = rig.camera
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    dv = (design(x.ravel(), y.ravel()) @ coefficients).reshape(u.shape)
    first, second = cv2.convertMaps(u.astype(np.float32), (v + dv).astype(np.float32), cv2.CV_16SC2)
    return np.asarray(first, np.int16), np.asarray(second, np.uint16)


def align(right: Image, row_maps: Maps) -> Image:
    """The right image (h, w) with its rows on the left's; the outermost rows repeat."""
    return np.asarray(cv2.remap(right, row_maps[0], row_maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
