"""Rendering of rasters of the map's grid at given places: bilinear over what is known, no edge blurred."""

import numpy as np
from numba import njit

from wayloom.ground.kernels.resampling import EDGE_MM


@njit(cache=True, error_model="numpy", nogil=True)
def draw_colour(colour, seen, x, y, out):  # type: ignore[no-untyped-def]
    """RGBA (P, Q, 4) uint8, in place, of colour (H, W, C) at x, y (P, Q) in pixels, whole at their middles; clear where the nearest
    pixel was not seen (H, W)."""
    rows, columns, channels = colour.shape
    total = np.zeros(3)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            row, column = int(np.floor(y[i, j] + 0.5)), int(np.floor(x[i, j] + 0.5))
            if row < 0 or column < 0 or row >= rows or column >= columns or not seen[row, column]:
                continue
            r0, c0 = int(np.floor(y[i, j])), int(np.floor(x[i, j]))
            weight, total[:] = 0.0, 0.0
            for r in range(max(r0, 0), min(r0 + 2, rows)):
                for c in range(max(c0, 0), min(c0 + 2, columns)):
                    if seen[r, c]:
                        w = (1.0 - abs(x[i, j] - c)) * (1.0 - abs(y[i, j] - r))
                        weight += w
                        for k in range(3):
                            total[k] += w * colour[r, c, k if channels == 3 else 0]
            for k in range(3):
                out[i, j, k] = int(np.rint(total[k] / weight))
            out[i, j, 3] = 255


@njit(cache=True, error_model="numpy", nogil=True)
def draw_height(height_mm, nothing, x, y, out):  # type: ignore[no-untyped-def]
    """m (P, Q), in place, of height_mm (H, W) int32 at x, y (P, Q) in cells, whole at their middles; NaN where the nearest cell is
    `nothing`."""
    rows, columns = height_mm.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = np.nan
            row, column = int(np.floor(y[i, j] + 0.5)), int(np.floor(x[i, j] + 0.5))
            if row < 0 or column < 0 or row >= rows or column >= columns or height_mm[row, column] == nothing:
                continue
            own = int(height_mm[row, column])
            r0, c0 = int(np.floor(y[i, j])), int(np.floor(x[i, j]))
            weight, total = 0.0, 0.0
            for r in range(max(r0, 0), min(r0 + 2, rows)):
                for c in range(max(c0, 0), min(c0 + 2, columns)):
                    if height_mm[r, c] != nothing and abs(int(height_mm[r, c]) - own) <= EDGE_MM:
                        w = (1.0 - abs(x[i, j] - c)) * (1.0 - abs(y[i, j] - r))
                        weight += w
                        total += w * (int(height_mm[r, c]) - own)
            out[i, j] = (own + total / weight) / 1000.0


@njit(cache=True, error_model="numpy", nogil=True)
def draw_nearest(values, nothing, x, y, out):  # type: ignore[no-untyped-def]
    """Values (P, Q) uint8, in place, of the nearest of values (H, W) at x, y (P, Q); `nothing` beyond them."""
    rows, columns = values.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            row, column = int(np.floor(y[i, j] + 0.5)), int(np.floor(x[i, j] + 0.5))
            inside = row >= 0 and column >= 0 and row < rows and column < columns
            out[i, j] = values[row, column] if inside else nothing
