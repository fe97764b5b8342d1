"""The texture stack: every material painted, with its mip pyramid."""

from collections.abc import Callable
from typing import Final

import numpy as np

from wayloom.simulation import paint_facades, paint_ground, paint_objects, paint_vehicles
from wayloom.simulation.canvas import Canvas, Image
from wayloom.simulation.kernels.arrays import TextureStack
from wayloom.simulation.materials import CUTOUTS, SMOOTH, Material, flags, glows, reliefs

Painter = Callable[[Canvas], Image]
PAINTERS: Final[dict[Material, Painter]] = {
    **paint_ground.PAINTERS,
    **paint_facades.PAINTERS,
    **paint_objects.PAINTERS,
    **paint_vehicles.PAINTERS,
}
STORED_GAMMA = 2.0
"""Texels keep the square root of linear colour, so that dark tones are not banded."""


def paint_textures(seed: int, size: int) -> TextureStack:
    """All materials at `size` texels (a power of two), each from its own random stream."""
    layers = np.stack([PAINTERS[m](Canvas(np.random.default_rng([seed, m]), size)) for m in Material])
    levels: list[Image] = [layers]
    while levels[-1].shape[1] > 1:
        a = levels[-1]
        levels.append((a[:, ::2, ::2] + a[:, 1::2, ::2] + a[:, ::2, 1::2] + a[:, 1::2, 1::2]) * np.float32(0.25))
    for m in CUTOUTS:
        _keep_coverage([level[m] for level in levels])
    offsets = np.cumsum([0, *(level.shape[0] * level.shape[1] * level.shape[2] for level in levels)]).astype(np.int64)
    texels = np.concatenate([_quantised(level).reshape(-1, 4) for level in levels])
    return TextureStack(texels, offsets, size, flags(CUTOUTS), flags(SMOOTH), reliefs(), glows())


def _keep_coverage(levels: list[Image]) -> None:
    """Scale each coarser level's coverage, in place, so that as much of it is over one half as of the finest.

    Without it foliage and fences would thin out with distance.
    """
    covered = float((levels[0][..., 3] > 0.5).mean())
    for level in levels[1:]:
        coverage = level[..., 3]
        threshold = float(np.quantile(coverage, 1 - covered)) if coverage.size > 4 else 0.5
        coverage *= 0.5 / max(threshold, 1e-3)


def _quantised(level: Image) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Linear (…, 4) to stored uint8."""
    out = np.clip(level, 0.0, 1.0)
    out[..., :3] **= np.float32(1.0 / STORED_GAMMA)
    return np.asarray(out * 255.0 + 0.5, np.uint8)
