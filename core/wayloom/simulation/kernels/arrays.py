"""Named tuples of arrays that the rendering kernels share.

World axes: x east, y north, z up, metres. Camera axes: x right, y down, z forward.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]
Number = Any
"""A float32 or a float64: kernels mix them."""
Rgb = tuple[Number, Number, Number]
Rgba = tuple[Number, Number, Number, Number]


class Triangles(NamedTuple):
    """Triangles to draw, row by row.

    corners   (T, 3, 3) float32 m, world
    uv        (T, 3, 2) float32 texture coordinates, 1 = one repeat
    normals   (T, 3, 3) float32 unit, world, at the corners
    material  (T,) uint8 layer of the texture stack
    tint      (T, 3) float32 linear factor on the texture's colour
    """

    corners: Float32
    uv: Float32
    normals: Float32
    material: UInt8
    tint: Float32


class TextureStack(NamedTuple):
    """All textures with their mip pyramids, flattened.

    texels   (M, 4) uint8: square root of linear RGB, then gloss, or coverage for cut-out layers
    offsets  (levels + 1,) int64 first row of each level
    size     edge of level 0 in texels, a power of two
    cutout   (L,) uint8: 1 where coverage under one half is a hole
    smooth   (L,) uint8: 1 where no large-scale stain is laid over the texture
    relief   (L,) float32: spread of what a rough surface throws towards a viewer, as a share; differs with his place
    glow     (L,) float32: light that the texture gives of itself, as a factor on the square of its colour
    """

    texels: UInt8
    offsets: NDArray[np.int64]
    size: int
    cutout: UInt8
    smooth: UInt8
    relief: Float32
    glow: Float32


class DepthMap(NamedTuple):
    """Largest coordinate along an axis seen from infinity: values (H, W) float32 m; texel (0, 0)'s edge lies at (x0, y0) m."""

    values: Float32
    x0: float
    y0: float
    texels_per_m: float


class Light(NamedTuple):
    """Sun, sky and what stands in their way.

    axes       (3, 3) rows: two directions across the sun's rays, and the direction to the sun
    near, far  DepthMap of standing things along the sun's rays, fine and near, coarse and wide
    movers     DepthMap of moving things
    openness   DepthMap-like (H, W) share of the sky seen from the ground, and its place
    ground     (H, W) float32 m, height of the ground at the texels of openness
    surface    (H, W) float32 m, height of the highest standing thing there
    clouds     (C, C) float32, C a power of two: tileable noise of zero mean, unit spread
    stains     (C, C) float32, likewise, for large-scale variation of surfaces
    facets     (F, F) float32, likewise, for what differs with the viewer's place
    sun_rgb, sky_rgb, horizon_rgb  (3,) float32 linear radiance
    cloud_cover  0 clear … 1 overcast
    haze_per_m   extinction, 1/m
    wetness      of the ground: 0 dry … 1 standing water
    """

    axes: Float32
    near: DepthMap
    far: DepthMap
    movers: DepthMap
    openness: DepthMap
    ground: Float32
    surface: Float32
    clouds: Float32
    stains: Float32
    facets: Float32
    sun_rgb: Float32
    sky_rgb: Float32
    horizon_rgb: Float32
    cloud_cover: float
    haze_per_m: float
    wetness: float


class View(NamedTuple):
    """A pinhole camera in the world: fx, fy, cx, cy in pixels; T_world_cam (4, 4) float64."""

    fx: float
    fy: float
    cx: float
    cy: float
    T_world_cam: Float64
