"""Resampling of ground sheets onto the map's grid.

A sheet is a tuple of arrays: height_mm (H, W) int16, sigma_mm (H, W) uint8, votes (H, W, 3) uint16, colour (2H, 2W, C) uint8,
sharpness (2H, 2W) uint8, corner (2,) int32, T (4, 4) from the sheet's frame to the map's, inverse (2, 2) of T[:2, :2], middle:
a height of the sheet, m, where the iteration begins. A map point (x, y) is looked for on the sheet's surface: the sheet may lean.
"""

import numpy as np
from numba import njit

CELL_M = 0.10
PIXEL_M = 0.05
NO_HEIGHT = -32768
STEPS = 2
EDGE_MM = 40
"""Neighbours that lie further off are across an edge, a kerb's: heights are not interpolated over it."""


@njit(cache=True, error_model="numpy", nogil=True)
def place(sheet, x, y):  # type: ignore[no-untyped-def]
    """u, v, m in the sheet's frame, of its surface's point at x, y of the map; row and column of its cell, -1 without surface."""
    height_mm, corner, T, inverse = sheet[0], sheet[5], sheet[6], sheet[7]
    h = sheet[8]
    u, v, row, column = 0.0, 0.0, -1, -1
    for _ in range(STEPS):
        dx, dy = x - T[0, 3] - T[0, 2] * h, y - T[1, 3] - T[1, 2] * h
        u, v = inverse[0, 0] * dx + inverse[0, 1] * dy, inverse[1, 0] * dx + inverse[1, 1] * dy
        column, row = int(np.floor(u / CELL_M)) - corner[0], int(np.floor(v / CELL_M)) - corner[1]
        if (
            row < 0
            or column < 0
            or row >= height_mm.shape[0]
            or column >= height_mm.shape[1]
            or height_mm[row, column] == NO_HEIGHT
        ):
            row, column = -1, -1
        else:
            h = height_mm[row, column] / 1000.0
    return u, v, row, column


@njit(cache=True, error_model="numpy", nogil=True)
def height_of(sheet, u, v, row, column):  # type: ignore[no-untyped-def]
    """z, mm in the map's frame, of the surface at u, v, whose cell is (row, column): bilinear, but not across edges."""
    height_mm, corner, T = sheet[0], sheet[5], sheet[6]
    own = height_mm[row, column]
    x, y = u / CELL_M - corner[0] - 0.5, v / CELL_M - corner[1] - 0.5
    c0, r0 = int(np.floor(x)), int(np.floor(y))
    total, weight = 0.0, 0.0
    for r in range(r0, r0 + 2):
        for c in range(c0, c0 + 2):
            if r < 0 or c < 0 or r >= height_mm.shape[0] or c >= height_mm.shape[1]:
                continue
            h = height_mm[r, c]
            if h != NO_HEIGHT and abs(int(h) - int(own)) <= EDGE_MM:
                w = (1.0 - abs(x - c)) * (1.0 - abs(y - r))
                total += w * h
                weight += w
    h = total / weight if weight > 0.0 else float(own)
    return 1000.0 * (T[2, 0] * u + T[2, 1] * v + T[2, 3]) + T[2, 2] * h


@njit(cache=True, error_model="numpy", nogil=True)
def colour_of(sheet, u, v, out):  # type: ignore[no-untyped-def]
    """Sharpness of the pixel at u, v, 0 where nothing was seen; its colour, bilinear over the pixels seen, into out (C,)."""
    colour, sharpness, corner = sheet[3], sheet[4], sheet[5]
    x, y = u / PIXEL_M - 2 * corner[0] - 0.5, v / PIXEL_M - 2 * corner[1] - 0.5
    column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    if row < 0 or column < 0 or row >= sharpness.shape[0] or column >= sharpness.shape[1] or sharpness[row, column] == 0:
        return 0
    c0, r0 = int(np.floor(x)), int(np.floor(y))
    weight = 0.0
    out[:] = 0.0
    for r in range(r0, r0 + 2):
        for c in range(c0, c0 + 2):
            if r < 0 or c < 0 or r >= sharpness.shape[0] or c >= sharpness.shape[1] or sharpness[r, c] == 0:
                continue
            w = (1.0 - abs(x - c)) * (1.0 - abs(y - r))
            weight += w
            for k in range(colour.shape[2]):
                out[k] += w * colour[r, c, k]
    for k in range(colour.shape[2]):
        out[k] /= weight
    return int(sharpness[row, column])
