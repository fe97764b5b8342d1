"""Normalised correlation of an orthophoto with the true texture of a simulated city's ground, cell by cell."""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.evaluation.made_ground import made_sheet
from wayloom.geometry import se3
from wayloom.ground.sheet import PIXEL_M, GroundSheet
from wayloom.simulation.rendering.renderer import World

FloatArray = NDArray[np.float64]
BLOCK_PX: Final = 20
"""Pixels of a side of the cells that are correlated: 1 m."""
TILE_BLOCKS, MARGIN_M = 16, 1.0
LEAST_SHARE: Final = 0.9
"""Of a cell's pixels that must be seen."""


def texture_correlation(sheet: GroundSheet, T_enu_sheet: FloatArray, world: World) -> tuple[FloatArray, FloatArray]:
    """correlation (N,) -1 to 1 and sharpness (N,) px/m of the sheet's cells of 1 m, those without contrast left out.

    The truth is the ground alone, rendered from straight above at the sheet's pixels: what objects throw shadows on is not lit so.
    """
    found = [_of_tile(sheet, rows, columns, T_enu_sheet, world) for rows, columns in _tiles(sheet)]
    both = np.concatenate([np.zeros((0, 2)), *found])
    both = both[np.isfinite(both[:, 0])]
    return both[:, 0], both[:, 1]


def block_correlation(one: FloatArray, other: FloatArray, seen: NDArray[np.bool_]) -> FloatArray:
    """(rows / BLOCK_PX, columns / BLOCK_PX): Pearson's of the seen pixels of two images (rows, columns); NaN where fewer than
    LEAST_SHARE are seen or an image has no contrast."""
    weight = _blocks(seen.astype(np.float64))
    known = weight.sum(axis=-1) >= LEAST_SHARE * BLOCK_PX**2
    count = np.maximum(weight.sum(axis=-1, keepdims=True), 1.0)
    a, b = (weight * (values - (weight * values).sum(axis=-1, keepdims=True) / count) for values in map(_blocks, (one, other)))
    norm = np.sqrt((a * a).sum(axis=-1) * (b * b).sum(axis=-1))
    return np.where(known & (norm > 0.0), (a * b).sum(axis=-1) / np.where(norm > 0.0, norm, 1.0), np.nan)


def _tiles(sheet: GroundSheet) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of pixels, whole cells of 1 m, of the tiles that show anything."""
    step = TILE_BLOCKS * BLOCK_PX
    height, width = (side // BLOCK_PX * BLOCK_PX for side in sheet.sharpness.shape)
    for row in range(0, height, step):
        for column in range(0, width, step):
            rows, columns = slice(row, min(row + step, height)), slice(column, min(column + step, width))
            if sheet.sharpness[rows, columns].any():
                yield rows, columns


def _of_tile(sheet: GroundSheet, rows: slice, columns: slice, T_enu_sheet: FloatArray, world: World) -> FloatArray:
    """(N, 2) correlation and sharpness of the tile's cells."""
    r, c = np.mgrid[rows, columns]
    z = np.nan_to_num(sheet.height[r // 2, c // 2])
    xyz = np.column_stack(
        [sheet.corner_m[0] + PIXEL_M * (c.ravel() + 0.5), sheet.corner_m[1] + PIXEL_M * (r.ravel() + 0.5), z.ravel()]
    )
    enu = se3.transform(T_enu_sheet, xyz)[:, :2]
    low, high = enu.min(axis=0) - MARGIN_M, enu.max(axis=0) + MARGIN_M
    centre = (low + high) / 2
    true = made_sheet(world, (float(centre[0]), float(centre[1])), (float(high[0] - low[0]), float(high[1] - low[1])))
    at = ((enu - centre - true.corner_m) / PIXEL_M - 0.5).reshape(*r.shape, 2).astype(np.float32)
    there = cv2.remap(_grey(true.colour), at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    seen = sheet.sharpness[rows, columns] > 0
    correlation = block_correlation(_grey(sheet.colour[rows, columns]).astype(np.float64), there, seen)
    sharpness = _blocks(sheet.sharpness[rows, columns].astype(np.float64)).mean(axis=-1)
    return np.column_stack([correlation.ravel(), sharpness.ravel()])


def _grey(colour: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W) mean of the channels."""
    return np.asarray(colour.mean(axis=2), np.float32)


def _blocks(image: FloatArray) -> FloatArray:
    """(H / BLOCK_PX, W / BLOCK_PX, BLOCK_PX^2) of an image (H, W)."""
    height, width = image.shape[0] // BLOCK_PX, image.shape[1] // BLOCK_PX
    parts = image.reshape(height, BLOCK_PX, width, BLOCK_PX).swapaxes(1, 2)
    return np.asarray(parts.reshape(height, width, -1), np.float64)
