"""Whether a point is really seen where it projects to: its looks, and what stands before it."""

import numpy as np
from numba import njit

_FLAT = 1.0
"""Sum of squared grey values about their mean under which a patch has no looks."""


@njit(cache=True, error_model="numpy", inline="always")
def _grey_at(image, u, v):  # type: ignore[no-untyped-def]
    """Bilinear; beyond the border the border's own value."""
    height, width = image.shape
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    u0 = min(int(u), width - 2)
    v0 = min(int(v), height - 2)
    a, b = u - u0, v - v0
    top = image[v0, u0] * (1.0 - a) + image[v0, u0 + 1] * a
    below = image[v0 + 1, u0] * (1.0 - a) + image[v0 + 1, u0 + 1] * a
    return top * (1.0 - b) + below * b


@njit(cache=True, error_model="numpy", inline="always")
def _look_at(image, u, v, scale, side, look):  # type: ignore[no-untyped-def]
    """Fill look (side * side,) float32: see `patches`. u and v must be finite."""
    half = 0.5 * (side - 1)
    mean = 0.0
    for i in range(side * side):
        du, dv = (i % side - half) * scale, (i // side - half) * scale
        look[i] = _grey_at(image, u + du, v + dv)
        mean += look[i]
    mean /= side * side
    square = 0.0
    for i in range(side * side):
        look[i] -= mean
        square += look[i] * look[i]
    norm = np.float32(1.0 / np.sqrt(square)) if square > _FLAT else np.float32(0.0)
    for i in range(side * side):
        look[i] *= norm


@njit(cache=True, error_model="numpy")
def patches(image, uv, scale, side):  # type: ignore[no-untyped-def]
    """The looks of N points: side x side grey values around each, their mean taken off, of length 1.

    image    (h, w) uint8, at least 2 x 2
    uv       (N, 2) pixels; NaN gives no looks
    scale    (N,) distance of the samples in pixels
    returns  (N, side * side) float32; zeros for a point without looks: one on a flat patch
    """
    looks = np.zeros((len(uv), side * side), np.float32)
    for n in range(len(uv)):
        if np.isfinite(uv[n, 0]) and np.isfinite(uv[n, 1]):
            _look_at(image, uv[n, 0], uv[n, 1], scale[n], side, looks[n])
    return looks


@njit(cache=True, error_model="numpy")
def likeness(looks, side, small, times_smaller, size, uv, nearness, inverse_depth, may):  # type: ignore[no-untyped-def]
    """How much N points look in an observer's image as in their host's: the correlation of both looks, 0 to 1; negative ones are 0.

    looks          (N, side * side) float32 from `patches`, in the host
    small          (h / times_smaller, w / times_smaller) uint8, the observer's
    size           (h, w) of the observer's whole image
    uv             (N, 2) pixels of that
    nearness       (N,) float32 1/m in the observer, inverse_depth (N,) 1/m in the host: looks grow as one over the other
    may            (N,) bool: the others are not looked at
    returns        (N,) float32; 0 outside the image and where the nearness is 0
    """
    found = np.zeros(len(uv), np.float32)
    look = np.empty(side * side, np.float32)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        inside = u >= -0.5 and v >= -0.5 and u < size[1] - 0.5 and v < size[0] - 0.5
        if not (inside and may[n] and nearness[n] > 0.0):
            continue
        scale = nearness[n] / inverse_depth[n]
        _look_at(small, (u + 0.5) / times_smaller - 0.5, (v + 0.5) / times_smaller - 0.5, scale, side, look)
        product = 0.0
        for i in range(side * side):
            product += looks[n, i] * look[i]
        found[n] = min(max(product, 0.0), 1.0)
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
