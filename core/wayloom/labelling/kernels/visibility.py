"""Visibility of a point in an observer: patch descriptors, their normalised cross-correlation, and an occlusion buffer."""

import numpy as np
from numba import njit

PATCH_SIDE = 3
"""A patch is PATCH_SIDE x PATCH_SIDE samples."""
_Index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
_ONE = _Index(1)
_MIN_SQUARED_NORM = 1.0
"""Squared norm of a zero-mean patch, in grey values, up to which it counts as flat."""


@njit(cache=True, error_model="numpy", inline="always")
def _sample_descriptor(image, u, v, scale, descriptor, across, columns):  # type: ignore[no-untyped-def]
    """Fill descriptor (PATCH_SIDE * PATCH_SIDE,) float32: see `patch_descriptors`. u and v must be finite.

    Bilinear interpolation; the border's value is repeated beyond it.
    across (PATCH_SIDE,) float32 and columns (PATCH_SIDE,) uint64 are working space.
    """
    height, width = image.shape
    for i in range(PATCH_SIDE):
        x = min(max(u + (i - (PATCH_SIDE - 1) // 2) * scale, np.float32(0.0)), np.float32(width - 1))
        column = min(int(x), width - 2)
        across[i], columns[i] = x - np.float32(column), _Index(column)
    mean = np.float32(0.0)
    for j in range(PATCH_SIDE):
        y = min(max(v + (j - (PATCH_SIDE - 1) // 2) * scale, np.float32(0.0)), np.float32(height - 1))
        above = min(int(y), height - 2)
        down, row = y - np.float32(above), _Index(above)
        for i in range(PATCH_SIDE):
            beside, column = across[i], columns[i]
            top, bottom = np.float32(image[row, column]), np.float32(image[row + _ONE, column])
            top += beside * (np.float32(image[row, column + _ONE]) - top)
            bottom += beside * (np.float32(image[row + _ONE, column + _ONE]) - bottom)
            descriptor[PATCH_SIDE * j + i] = top + down * (bottom - top)
            mean += descriptor[PATCH_SIDE * j + i]
    mean /= np.float32(PATCH_SIDE * PATCH_SIDE)
    square = np.float32(0.0)
    for i in range(PATCH_SIDE * PATCH_SIDE):
        descriptor[i] -= mean
        square += descriptor[i] * descriptor[i]
    norm = np.float32(1.0) / np.sqrt(square) if square > _MIN_SQUARED_NORM else np.float32(0.0)
    for i in range(PATCH_SIDE * PATCH_SIDE):
        descriptor[i] *= norm


@njit(cache=True, error_model="numpy")
def patch_descriptors(image, uv, scale):  # type: ignore[no-untyped-def]
    """Descriptors of N points: the PATCH_SIDE x PATCH_SIDE grey values around each, zero-mean and of unit norm.

    image    (h, w) uint8, at least 2 x 2
    uv       (N, 2) pixels; NaN gives zeros
    scale    (N,) distance of the samples in pixels
    returns  (N, PATCH_SIDE * PATCH_SIDE) float32; zeros for a flat patch
    """
    descriptors = np.zeros((len(uv), PATCH_SIDE * PATCH_SIDE), np.float32)
    across, columns = np.empty(PATCH_SIDE, np.float32), np.empty(PATCH_SIDE, np.uint64)
    for n in range(len(uv)):
        if np.isfinite(uv[n, 0]) and np.isfinite(uv[n, 1]):
            _sample_descriptor(
                image, np.float32(uv[n, 0]), np.float32(uv[n, 1]), np.float32(scale[n]), descriptors[n], across, columns
            )
    return descriptors


@njit(cache=True, error_model="numpy")
def ncc_weights(descriptors, small, scale_down, size, uv, d_observer, d_host, candidate, min_ncc, power):  # type: ignore[no-untyped-def]
    """Normalised cross-correlation (NCC) of N points' patches in host and observer, to a power.

    descriptors    (N, PATCH_SIDE * PATCH_SIDE) float32 from `patch_descriptors`, in the host
    small          (h / scale_down, w / scale_down) uint8, the observer's
    size           (h, w) of the observer's whole image
    uv             (N, 2) pixels of that
    d_observer     (N,) float32 inverse depth in the observer, 1/m; d_host (N,) in the host: a patch scales as one over the other
    candidate      (N,) bool: the others get 0
    min_ncc        a correlation below this counts as 0
    returns        (N,) float32, 0 to 1; 0 outside the image and where the inverse depth is 0
    """
    weights = np.zeros(len(uv), np.float32)
    descriptor, across = np.empty(PATCH_SIDE * PATCH_SIDE, np.float32), np.empty(PATCH_SIDE, np.float32)
    columns = np.empty(PATCH_SIDE, np.uint64)
    shrink = np.float32(1.0 / scale_down)
    half = np.float32(0.5)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        inside = u >= -0.5 and v >= -0.5 and u < size[1] - 0.5 and v < size[0] - 0.5
        if not (inside and candidate[n] and d_observer[n] > 0.0):
            continue
        scale = d_observer[n] / np.float32(d_host[n])
        x, y = (np.float32(u) + half) * shrink - half, (np.float32(v) + half) * shrink - half
        _sample_descriptor(small, x, y, scale, descriptor, across, columns)
        ncc = np.float32(0.0)
        for i in range(PATCH_SIDE * PATCH_SIDE):
            ncc += descriptors[n, i] * descriptor[i]
        if ncc >= min_ncc:
            ncc = min(ncc, np.float32(1.0))
            weights[n] = (ncc * ncc) * (ncc * ncc) if power == 4.0 else ncc**power
    return weights


@njit(cache=True, error_model="numpy")
def occlusion_buffer(uv, inverse_depth, cell_px, rows, columns):  # type: ignore[no-untyped-def]
    """A coarse depth buffer: the largest inverse depth of the given points in each cell of an image, 0 where there is none.

    uv (N, 2) pixels, those outside are left out; inverse_depth (N,) 1/m; returns (rows, columns) float32
    """
    buffer = np.zeros((rows, columns), np.float32)
    for n in range(len(uv)):
        u, v = (uv[n, 0] + 0.5) / cell_px, (uv[n, 1] + 0.5) / cell_px
        if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
            buffer[int(v), int(u)] = max(buffer[int(v), int(u)], inverse_depth[n])
    return buffer


@njit(cache=True, error_model="numpy")
def occluded(uv, inverse_depth, buffer, cell_px, margin):  # type: ignore[no-untyped-def]
    """Depth test against an `occlusion_buffer`: whether the nearest point in a projection's cell is nearer by the margin.

    uv (N, 2) pixels; inverse_depth (N,) 1/m in this image; buffer (rows, columns); margin: share of the depth
    returns (N,) bool
    """
    rows, columns = buffer.shape
    hidden = np.zeros(len(uv), np.bool_)
    for n in range(len(uv)):
        u, v = (uv[n, 0] + 0.5) / cell_px, (uv[n, 1] + 0.5) / cell_px
        if u >= 0.0 and v >= 0.0 and u < columns and v < rows:
            hidden[n] = buffer[int(v), int(u)] * (1.0 - margin) > inverse_depth[n]
    return hidden
