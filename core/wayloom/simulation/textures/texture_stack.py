"""Texture stack: every material painted, with its mip pyramid."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.kernels.arrays import TextureStack
from wayloom.simulation.textures import paint_facades, paint_ground, paint_objects, paint_vehicles
from wayloom.simulation.textures.canvas import Canvas, Image
from wayloom.simulation.textures.materials import CUTOUTS, SMOOTH, Material, flags, glows, reliefs

Painter = Callable[[Canvas], Image]
Texels = NDArray[np.uint8]
PAINTERS: Final[dict[Material, Painter]] = {
    **paint_ground.PAINTERS,
    **paint_facades.PAINTERS,
    **paint_objects.PAINTERS,
    **paint_vehicles.PAINTERS,
}


def paint_textures(seed: int, size: int) -> TextureStack:
    """All materials at `size` texels (a power of two), each from its own random stream."""
    pyramids = [_pyramid(PAINTERS[m](Canvas(np.random.default_rng([seed, m]), size)), m in CUTOUTS) for m in Material]
    levels = [np.concatenate([pyramid[k] for pyramid in pyramids]) for k in range(len(pyramids[0]))]
    offsets = np.cumsum([0, *(len(level) for level in levels)]).astype(np.int64)
    return TextureStack(np.concatenate(levels), offsets, size, flags(CUTOUTS), flags(SMOOTH), reliefs(), glows())


def _pyramid(finest: Image, cutout: bool) -> list[Texels]:
    """One material's levels as rows of texels, finest first."""
    levels = [finest]
    while len(levels[-1]) > 1:
        a = levels[-1]
        levels.append((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]) * np.float32(0.25))
    if cutout:
        _keep_coverage(levels)
    return [_quantised(level).reshape(-1, 4) for level in levels]


def _keep_coverage(levels: list[Image]) -> None:
    """Scale each coarser level's coverage, in place, so that as much of it is over one half as of the finest.

    Without it foliage and fences would thin out with distance.
    """
    covered = float((levels[0][..., 3] > 0.5).mean())
    for level in levels[1:]:
        coverage = level[..., 3]
        threshold = float(np.quantile(coverage, 1 - covered)) if coverage.size > 4 else 0.5
        coverage *= 0.5 / max(threshold, 1e-3)


def _quantised(level: Image) -> Texels:
    """Linear (…, 4) to stored uint8: the square root of the colour, so that dark tones are not banded."""
    out = np.clip(level, 0.0, 1.0)
    np.sqrt(out[..., :3], out=out[..., :3])
    out *= np.float32(255.0)
    out += np.float32(0.5)
    return out.astype(np.uint8)
