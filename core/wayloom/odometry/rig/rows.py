"""Rectification of the right image: its rows brought onto the left's, and the rig's lens undone where it is known.

A left pixel whose match has the normalised coordinates (x, y) lies in the right image, beside what the lens does, at row v + dv,
    dv = c0 (1 + y^2) + c1 x + c2 x y,
a small rotation of the right camera about x and z, and the keystone that lens errors leave. A rotation moves columns too, by
c0 x y - c1 y, which is undone with it; what a keystone does to columns depends on the lens, so they are left alone there: the
disparity bias is an unknown of the window. What the calibration itself says of the rows (t_right_left y and z) is taken off first.
The coefficients are fitted to refined matches of a few frames before the drive starts and follow those of every third keyframe.
"""

from copy import copy

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import IDENTITY, RightLens, at_infinity, displaced
from wayloom.odometry.kernels.resampling import STEP, resample
from wayloom.odometry.kernels.stereo import NO_MATCH, refine_both_axes
from wayloom.odometry.points import selection, stereo

HALF = 5
MIN_EIGENVALUE = 30.0
RESIDUAL_SCALE_PX = 0.15
MIN_MATCHES = 60
RIDGE = 0.01  # matches' worth of pull to zero: an image without matches in its corners keeps a small keystone
FARTHEST_PX = float(2**20)
KEYFRAME_MATCHES = 96
"""Matches that are refined at a keyframe, at most."""
FOLLOW_EVERY = 3
MEMORY = 0.9
"""Every third keyframe's matches are taken; of the older ones so much is kept each time: about 900 matches, 30 keyframes."""
RENEWAL_PX = 0.02
"""The displacements are made anew when they are off by more anywhere."""
Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Corners = NDArray[np.float32]
TERMS = 5
"""Unknowns of the fit: c0, c1, c2 and two nuisance terms in disparity."""


def row_matches(left: Image, right: Image, max_disparity: int = 180) -> FloatArray:
    """Stereo matches of one pair (h, w) with their row offsets: (n, 4) of left u, v, disparity, dv in px."""
    pixels = selection.select_candidates(left, np.zeros((0, 2)), 8, 32, 7.0, HALF + 4)
    found = stereo.match(left, right, pixels, max_disparity, 0.85, 12.0, 60)
    good = (found[:, 1] < NO_MATCH) & (found[:, 0] > 0.5)
    return refined(left, right, pixels[good], found[good, 0])


def refined(left: Image, right: Image, pixels: NDArray[np.int64], disparity: FloatArray) -> FloatArray:
    """The matches (n, 4) of `row_matches` from pixels (n, 2) and their disparities (n,) px, those that can be refined."""
    out = np.zeros((len(pixels), 3))
    refine_both_axes(left, right, pixels, disparity, HALF, MIN_EIGENVALUE, out)
    return np.column_stack([pixels, out[:, :2]])[out[:, 2] > 0]


def through_lens(matches: FloatArray, rig: StereoRig, lens: RightLens) -> FloatArray:
    """Matches (n, 4) as of `row_matches` in the log's right image, as they would be without the lens (its displacement stays)."""
    if lens.is_ideal:
        return matches
    u, v, disparity, dv = matches.T
    uv = at_infinity(lens).ideal_pixels(rig.camera, 0.0, np.column_stack([u - disparity, v + dv]))
    return np.column_stack([u, v, u - uv[:, 0], uv[:, 1] - v])


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
    A, target = _equations(matches, rig)
    c = np.zeros(TERMS)
    weight = np.ones(len(target))
    for _ in range(20):
        c = _solve(*_sums(A, target, weight))
        weight = _weights(A @ c - target)
    return c[:3]


def _equations(matches: FloatArray, rig: StereoRig) -> tuple[FloatArray, FloatArray]:
    """(n, 5) derivatives of dv by c0, c1, c2 and two nuisance terms in disparity, and what dv (n,) px they shall explain."""
    u, v, disparity, dv = matches.T
    camera = rig.camera
    x, y = (u - disparity - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    d = disparity / (0.1 * camera.width)
    return np.column_stack([design(x, y), d, y * d]), dv - known_row_offset(rig, v, disparity)


def _sums(A: FloatArray, target: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.einsum("ni,n,nj->ij", A, weight, A), np.einsum("ni,n,n->i", A, weight, target)


def _solve(H: FloatArray, g: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(H + RIDGE * np.eye(TERMS), g))


def _weights(residual: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + (residual / RESIDUAL_SCALE_PX) ** 2))


def shift(coefficients: FloatArray, rig: StereoRig, uv: FloatArray) -> FloatArray:
    """(n, 2) px: what the rows' misalignment (3,) px adds to right pixels uv (n, 2)."""
    camera = rig.camera
    x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
    return np.column_stack([coefficients[0] * x * y - coefficients[1] * y, design(x, y) @ coefficients])


def real_pixels(coefficients: FloatArray, rig: StereoRig, lens: RightLens, uv: FloatArray) -> FloatArray:
    """Pixels (n, 2) of the aligned right image to those of the log's right image."""
    moved = uv + shift(coefficients, rig, uv)
    return moved if lens.is_ideal else at_infinity(lens).real_pixels(rig.camera, 0.0, moved)


def displacements(coefficients: FloatArray, rig: StereoRig, lens: RightLens = IDENTITY) -> Corners:
    """(h // STEP + 2, w // STEP + 2, 2) px: what rows and lens move the aligned right image's pixels by, at cells' corners. Raises
    ValueError where that is no number, or more than any image has pixels."""
    across, down = rig.camera.width // STEP + 2, rig.camera.height // STEP + 2
    v, u = np.mgrid[0:down, 0:across].astype(np.float64) * STEP
    uv = np.column_stack([u.ravel(), v.ravel()])
    moved = real_pixels(coefficients, rig, lens, uv) - uv
    if not (np.abs(moved) < FARTHEST_PX).all():
        raise ValueError(f"rows and lens move pixels by {np.abs(moved).max():g} px")
    return np.asarray(moved.reshape(down, across, 2), np.float32)


def align(right: Image, corners: Corners, first_row: int = 0) -> Image:
    """The right image (h, w) with its rows on the left's by `displacements`, from one row on; the outermost pixels repeat. By
    cubics: linear interpolation blurs what lies between pixels, and disparities shrink by that. Raises ValueError for an image that
    is larger than that of the displacements."""
    height, width = right.shape
    if corners.shape[0] < height // STEP + 2 or corners.shape[1] < width // STEP + 2:
        raise ValueError(f"an image of {width}x{height} px is larger than what the displacements are of")
    return np.asarray(resample(np.ascontiguousarray(right), corners, first_row), np.uint8)


class RightRectifier:
    """The right camera of a drive as far as it is known. `align` makes its images those of `rig`, the log's rig with the lens's
    displacement; `follow` keeps the rows up to date.

    coefficients : (3,) px, those of the displacements
    """

    def __init__(self, rig: StereoRig, lens: RightLens, coefficients: FloatArray) -> None:
        self.rig, self.lens = displaced(rig, lens), lens
        self.H, self.g, self.seen = np.zeros((TERMS, TERMS)), np.zeros(TERMS), 0
        self.terms = np.concatenate([coefficients, np.zeros(TERMS - 3)])
        self._renew()

    def _renew(self) -> None:
        """Make the displacements by the coefficients."""
        self.coefficients = self.terms[:3].copy()
        ideal = self.lens.is_ideal and not self.coefficients.any()
        self.corners = None if ideal else displacements(self.coefficients, self.rig, self.lens)

    def frozen(self) -> "RightRectifier":
        """What it is now, which follows no keyframe of this one's. Its arrays are replaced, never changed."""
        return copy(self)

    def align(self, right: Image, first_row: int = 0) -> Image:
        """The log's right image (h, w) with rows and lens undone, from one row on."""
        return right[first_row:] if self.corners is None else align(right, self.corners, first_row)

    def real_pixels(self, uv: FloatArray) -> FloatArray:
        """Pixels (n, 2) of the aligned right image to those of the log's."""
        return real_pixels(self.coefficients, self.rig, self.lens, uv)

    def all_rows(self) -> FloatArray:
        """(3,) px: the coefficients that come nearest to what rows and lens do to the rows together."""
        if self.lens.is_ideal:
            return self.coefficients.copy()
        camera = self.rig.camera
        v, u = np.mgrid[0 : camera.height : STEP, 0 : camera.width : STEP].astype(np.float64)
        uv = np.column_stack([u.ravel(), v.ravel()])
        A = design((uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy)
        return np.asarray(np.linalg.lstsq(A, (self.real_pixels(uv) - uv)[:, 1])[0])

    def follow(self, left: Image, aligned: Image, pixels: NDArray[np.int64], disparity: FloatArray) -> None:
        """Let the rows follow a keyframe: its images (h, w), left pixels (n, 2) and their disparities (n,) px."""
        self.seen += 1
        if self.seen % FOLLOW_EVERY:
            return
        chosen = selection.spread_sample(pixels, KEYFRAME_MATCHES)
        matches = refined(left, aligned, pixels[chosen], disparity[chosen])
        if not len(matches):
            return
        A, target = _equations(matches, self.rig)
        target = target + A[:, :3] @ self.coefficients
        H, g = _sums(A, target, _weights(A @ self.terms - target))
        if not self.H.any():  # the start counts as much as a long drive
            self.H, self.g = self._start(H)
        self.H, self.g = MEMORY * self.H + H, MEMORY * self.g + g
        self.terms = _solve(self.H, self.g)
        if self._off_by() > RENEWAL_PX:
            self._renew()

    def _start(self, H: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums (5, 5), (5,) that hold the first coefficients as firmly as many keyframes like this one, H (5, 5), would."""
        start = H / (1.0 - MEMORY)
        return start, start @ self.terms

    def worst_px(self) -> float:
        """How far the rows are off in the corner where they are off the most, beside what the lens does, px."""
        return float(np.abs(shift(self.coefficients, self.rig, self._corners())[:, 1]).max())

    def _off_by(self) -> float:
        """px, at the worst corner, between the coefficients of the displacements and the latest."""
        return float(np.abs(shift(self.terms[:3] - self.coefficients, self.rig, self._corners())).max())

    def _corners(self) -> FloatArray:
        camera = self.rig.camera
        return np.array([(u, v) for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)])
