"""Whether a point is really seen where it projects to: its looks, and what stands before it."""

import numpy as np
from numba import njit

SIDE = 3
"""A point's looks are SIDE x SIDE grey values around it."""
_Index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
_ONE = _Index(1)
_FLAT = 1.0
"""Sum of squared grey values about their mean under which a patch has no looks."""


@njit(cache=True, error_model="numpy", inline="always")
def _look_at(image, u, v, scale, look, across, columns):  # type: ignore[no-untyped-def]
    """Fill look (SIDE * SIDE,) float32: see `patches`. Bilinear; beyond the border its own value. u and v must be finite.

    across (SIDE,) float32 and columns (SIDE,) uint64 are working space.
    """
    height, width = image.shape
    for i in range(SIDE):
        x = min(max(u + (i - (SIDE - 1) // 2) * scale, np.float32(0.0)), np.float32(width - 1))
        column = min(int(x), width - 2)
        across[i], columns[i] = x - np.float32(column), _Index(column)
    mean = np.float32(0.0)
    for j in range(SIDE):
        y = min(max(v + (j - (SIDE - 1) // 2) * scale, np.float32(0.0)), np.float32(height - 1))
        above = min(int(y), height - 2)
        down, row = y - np.float32(above), _Index(above)
        for i in range(SIDE):
            beside, column = across[i], columns[i]
            one, other = np.float32(image[row, column]), np.float32(image[row + _ONE, column])
            one += beside * (np.float32(image[row, column + _ONE]) - one)
            other += beside * (np.float32(image[row + _ONE, column + _ONE]) - other)
            look[SIDE * j + i] = one + down * (other - one)
            mean += look[SIDE * j + i]
    mean /= np.float32(SIDE * SIDE)
    square = np.float32(0.0)
    for i in range(SIDE * SIDE):
        look[i] -= mean
        square += look[i] * look[i]
    norm = np.float32(1.0) / np.sqrt(square) if square > _FLAT else np.float32(0.0)
    for i in range(SIDE * SIDE):
        look[i] *= norm


@njit(cache=True, error_model="numpy")
def patches(image, uv, scale):  # type: ignore[no-untyped-def]
    """The looks of N points: SIDE x SIDE grey values around each, their mean taken off, of length 1.

    image    (h, w) uint8, at least 2 x 2
    uv       (N, 2) pixels; NaN gives no looks
    scale    (N,) distance of the samples in pixels
    returns  (N, SIDE * SIDE) float32; zeros for a point without looks: one on a flat patch
    """
    looks = np.zeros((len(uv), SIDE * SIDE), np.float32)
    across, columns = np.empty(SIDE, np.float32), np.empty(SIDE, np.uint64)
    for n in range(len(uv)):
        if np.isfinite(uv[n, 0]) and np.isfinite(uv[n, 1]):
            _look_at(image, np.float32(uv[n, 0]), np.float32(uv[n, 1]), np.float32(scale[n]), looks[n], across, columns)
    return looks


@njit(cache=True, error_model="numpy")
def likeness(looks, small, times_smaller, size, uv, nearness, inverse_depth, may, least, power):  # type: ignore[no-untyped-def]
    """How much N points look in an observer's image as in their host's: the correlation of both looks, 0 to 1, to a power.

    looks          (N, SIDE * SIDE) float32 from `patches`, in the host
    small          (h / times_smaller, w / times_smaller) uint8, the observer's
    size           (h, w) of the observer's whole image
    uv             (N, 2) pixels of that
    nearness       (N,) float32 1/m in the observer, inverse_depth (N,) 1/m in the host: looks grow as one over the other
    may            (N,) bool: the others are not looked at
    least          a correlation under this counts as 0
    returns        (N,) float32; 0 outside the image and where the nearness is 0
    """
    found = np.zeros(len(uv), np.float32)
    look, across, columns = np.empty(SIDE * SIDE, np.float32), np.empty(SIDE, np.float32), np.empty(SIDE, np.uint64)
    shrink = np.float32(1.0 / times_smaller)
    half = np.float32(0.5)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        inside = u >= -0.5 and v >= -0.5 and u < size[1] - 0.5 and v < size[0] - 0.5
        if not (inside and may[n] and nearness[n] > 0.0):
            continue
        scale = nearness[n] / np.float32(inverse_depth[n])
        x, y = (np.float32(u) + half) * shrink - half, (np.float32(v) + half) * shrink - half
        _look_at(small, x, y, scale, look, across, columns)
        alike = np.float32(0.0)
        for i in range(SIDE * SIDE):
            alike += looks[n, i] * look[i]
        if alike >= least:
            alike = min(alike, np.float32(1.0))
            found[n] = (alike * alike) * (alike * alike) if power == 4.0 else alike**power
    return found


@njit(cache=True, error_model="numpy")
def nearest_seen(uv, inverse_depth, cell_px, rows, columns):  # type: ignore[no-untyped-def]
    """The inverse depth of the nearest of the points that are seen in each cell of an image, 0 where none is.

    uv (N, 2) pixels, those outside are left out; inverse_depth (N,) 1/m; returns (rows, columns) float32
    """
    found = np.zeros((rows, columns), np.float32)
    for n in range(len(uv)):
        u, v = (uv[n, 0] + 0.5) / cell_px, (uv[n, 1] + 0.5) / cell_px
        if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
            found[int(v), int(u)] = max(found[int(v), int(u)], inverse_depth[n])
    return found


@njit(cache=True, error_model="numpy")
def hidden(uv, inverse_depth, seen, cell_px, margin):  # type: ignore[no-untyped-def]
    """Whether what is seen around a projection stands before it: the nearest point seen in its cell is nearer by the margin.

    uv (N, 2) pixels; inverse_depth (N,) 1/m in this image; seen (rows, columns) of `nearest_seen`; margin: share of the depth
    returns (N,) bool
    """
    rows, columns = seen.shape
    found = np.zeros(len(uv), np.bool_)
    for n in range(len(uv)):
        u, v = (uv[n, 0] + 0.5) / cell_px, (uv[n, 1] + 0.5) / cell_px
        if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
            found[n] = seen[int(v), int(u)] * (1.0 - margin) > inverse_depth[n]
    return found
