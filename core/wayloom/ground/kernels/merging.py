"""Merge of ground sheets over a square of the map's grid: statistics by block, painting by rank, sums of heights and votes.

The window is given by `corner`, column and row of its first block (or cell) in the map's grid. A block has BLOCK x BLOCK cells.
Fields of balance are (S, 4, N, N): gains of three channels and an offset of height in mm at the middles of tiles of `TILE_BLOCKS`
blocks, for the window with its halo, which begins at tile `first` (2,) of the map's grid. All sums are of whole numbers.
"""

import numpy as np
from numba import njit

from wayloom.ground.kernels.resampling import CELL_M, PIXEL_M, colour_of, height_of, place

BLOCK = 8
"""Cells a block's edge: 0.8 m."""
TILE_BLOCKS = 4
"""Blocks a tile's edge: 3.2 m."""
SAMPLES = 4
"""A block is sampled at so many places along each axis."""
COLOURS, SEEN, SHARPNESS, HEIGHT, HEIGHTS, SIGMA = slice(0, 3), 3, 4, 5, 6, 7
"""Columns of a block's sums."""
PRECISION = 1e8
"""Weights are whole numbers: this over a variance in mm^2."""


@njit(cache=True, error_model="numpy", nogil=True)
def block_sums(sheet, corner, out):  # type: ignore[no-untyped-def]
    """Sums over samples of each block of a window (N, N, 8) int64, in place: colour, how many, sharpness, height mm, how many,
    sigma mm. Grey counts for all three channels."""
    step = BLOCK * CELL_M / SAMPLES
    colour = np.zeros(sheet[3].shape[2])
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for a in range(SAMPLES):
                for b in range(SAMPLES):
                    x = (corner[0] + j) * (BLOCK * CELL_M) + (b + 0.5) * step
                    y = (corner[1] + i) * (BLOCK * CELL_M) + (a + 0.5) * step
                    u, v, row, column = place(sheet, x, y)
                    sharp = colour_of(sheet, u, v, colour)
                    if sharp > 0:
                        for k in range(3):
                            out[i, j, k] += int(np.rint(16.0 * colour[k if len(colour) == 3 else 0]))
                        out[i, j, SEEN] += 1
                        out[i, j, SHARPNESS] += sharp
                    if row >= 0:
                        out[i, j, HEIGHT] += int(np.rint(height_of(sheet, u, v, row, column)))
                        out[i, j, HEIGHTS] += 1
                        out[i, j, SIGMA] += sheet[1][row, column]


@njit(cache=True, error_model="numpy", nogil=True)
def balance_at(field, first, x, y, out):  # type: ignore[no-untyped-def]
    """Bilinear value (4,) of one sheet's field (4, N, N) at x, y of the map, m; constant beyond its middles."""
    edge = TILE_BLOCKS * BLOCK * CELL_M
    n = field.shape[1]
    fx = min(max(x / edge - first[0] - 0.5, 0.0), n - 1.001)
    fy = min(max(y / edge - first[1] - 0.5, 0.0), n - 1.001)
    j, i = int(fx), int(fy)
    a, b = fx - j, fy - i
    for k in range(4):
        low = (1.0 - a) * field[k, i, j] + a * field[k, i, j + 1]
        high = (1.0 - a) * field[k, i + 1, j] + a * field[k, i + 1, j + 1]
        out[k] = (1.0 - b) * low + b * high


@njit(cache=True, error_model="numpy", nogil=True)
def paint(sheet, number, wanted, corner, field, first, level, out):  # type: ignore[no-untyped-def]
    """Paint the pixels that are still empty in the wanted blocks (N, N) bool of a window.

    level : (N + 2, N + 2, 3) gains at the middles of the window's blocks and of those around it
    out : colour (P, P, C) uint8, sharpness (P, P) uint8, shown (P, P) uint16, in place; `number` is written where it shows
    """
    colours, sharpness, shown = out
    span = 2 * BLOCK
    colour, balance = np.zeros(sheet[3].shape[2]), np.zeros(4)
    for i in range(wanted.shape[0]):
        for j in range(wanted.shape[1]):
            if not wanted[i, j]:
                continue
            for row in range(i * span, (i + 1) * span):
                for column in range(j * span, (j + 1) * span):
                    if shown[row, column] != 0:
                        continue
                    x = (corner[0] * span + column + 0.5) * PIXEL_M
                    y = (corner[1] * span + row + 0.5) * PIXEL_M
                    u, v, _, _ = place(sheet, x, y)
                    sharp = colour_of(sheet, u, v, colour)
                    if sharp == 0:
                        continue
                    balance_at(field, first, x, y, balance)
                    fx, fy = (column + 0.5) / span + 0.5, (row + 0.5) / span + 0.5
                    c, r = int(fx), int(fy)
                    a, b = fx - c, fy - r
                    for k in range(colours.shape[2]):
                        low = (1.0 - a) * level[r, c, k] + a * level[r, c + 1, k]
                        high = (1.0 - a) * level[r + 1, c, k] + a * level[r + 1, c + 1, k]
                        value = ((1.0 - b) * low + b * high) * balance[k] * colour[k if len(colour) == 3 else 0]
                        colours[row, column, k] = int(np.rint(min(max(value, 0.0), 255.0)))
                    sharpness[row, column], shown[row, column] = sharp, number


@njit(cache=True, error_model="numpy", nogil=True)
def lay(sheet, wanted, corner, field, first, height):  # type: ignore[no-untyped-def]
    """Height, mm, of the cells (Q, Q) float64 that have none yet (NaN) in the wanted blocks (N, N) bool, in place."""
    balance = np.zeros(4)
    for row in range(height.shape[0]):
        for column in range(height.shape[1]):
            if not wanted[row // BLOCK, column // BLOCK] or not np.isnan(height[row, column]):
                continue
            x, y = (corner[0] * BLOCK + column + 0.5) * CELL_M, (corner[1] * BLOCK + row + 0.5) * CELL_M
            u, v, r, c = place(sheet, x, y)
            if r >= 0:
                balance_at(field, first, x, y, balance)
                height[row, column] = height_of(sheet, u, v, r, c) + balance[3]


@njit(cache=True, error_model="numpy", nogil=True)
def add_cells(sheet, wanted, corner, field, first, about, height, out):  # type: ignore[no-untyped-def]
    """Add a sheet to the cells (Q, Q) of the wanted blocks (N, N) bool of a window.

    about  : the sheet's rank by age, 1 for the oldest; the variance of its place's height, mm^2, as a polynomial of second degree
             in x and y (`merge.place_variance`); how far, mm, a height may be from the best sheet's and count
    height : (Q, Q) mm of the best sheet there
    out    : in place, sums (Q, Q, 2) int64 of weights and of weights times tenths of a millimetre; best (Q, Q, 2) int64, the
             greatest weights of this drive's sheets, by the sheet and by its place; votes (Q, Q, 3) int64; looks (Q, Q) int64, how
             many sheets; newest (Q, Q) int64, the greatest rank by age
    """
    age, variance, gate_mm = about
    sums, best, votes, looks, newest = out
    balance = np.zeros(4)
    for row in range(height.shape[0]):
        for column in range(height.shape[1]):
            if not wanted[row // BLOCK, column // BLOCK]:
                continue
            x, y = (corner[0] * BLOCK + column + 0.5) * CELL_M, (corner[1] * BLOCK + row + 0.5) * CELL_M
            u, v, r, c = place(sheet, x, y)
            if r < 0:
                continue
            looks[row, column] += 1
            newest[row, column] = max(newest[row, column], age)
            for k in range(3):
                votes[row, column, k] += sheet[2][r, c, k]
            balance_at(field, first, x, y, balance)
            z = height_of(sheet, u, v, r, c) + balance[3]
            sigma = max(float(sheet[1][r, c]), 1.0)
            if abs(z - height[row, column]) > max(gate_mm, 3.0 * sigma):
                continue
            weight = max(int(np.rint(PRECISION / (sigma * sigma))), 1)
            common = (
                variance[0] + variance[1] * x + variance[2] * y + variance[3] * x * x + variance[4] * x * y + variance[5] * y * y
            )
            sums[row, column, 0] += weight
            sums[row, column, 1] += weight * int(np.rint(10.0 * z))
            best[row, column, 0] = max(best[row, column, 0], weight)
            best[row, column, 1] = max(best[row, column, 1], int(np.rint(PRECISION / max(common, 1.0))))
