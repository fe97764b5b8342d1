"""Raster tiles of the ground: orthophoto, height and surface as pictures of 512 x 512 pixels, and how four become a coarser one."""

from dataclasses import dataclass
from typing import Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.tiles.png import png_bytes

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]
"""(512, 512, 4) RGBA."""
RASTER_PX: Final = 512
WEBP_QUALITY: Final = 85
HEIGHT_ZERO_M: Final = 32_768.0
HEIGHT_STEPS: Final = 256.0
"""A metre of height in the blue channel's steps (the encoding known as terrarium)."""
CLEAR: Final = np.zeros((RASTER_PX, RASTER_PX, 4), np.uint8)


class RasterCodec(Protocol):
    """How a layer's tiles are written, and how four become one."""

    def encode(self, picture: Picture) -> bytes:
        """The tile's bytes: equal pictures give equal bytes."""

    def coarser(self, picture: Picture) -> Picture:
        """(n, n, 4) of (2n, 2n, 4)."""


@dataclass(frozen=True, slots=True)
class RasterLayer:
    """A layer of raster tiles of the ground: its name, media type, file ending, codec, and by how many zooms its finest is coarser
    than the orthophoto's."""

    name: str
    media_type: str
    suffix: str
    codec: RasterCodec
    coarser_by: int


class Photo:
    """WebP. What is clear stays out of means."""

    def encode(self, picture: Picture) -> bytes:
        """Lossy, its alpha exact."""
        _, data = cv2.imencode(".webp", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA), [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
        return bytes(data.tobytes())

    def coarser(self, picture: Picture) -> Picture:
        """Means of four pixels, each weighed by its alpha."""
        fours = _fours(picture).astype(np.int64)
        alpha = fours[..., 3].sum(axis=2)
        colour = (fours[..., :3] * fours[..., 3:]).sum(axis=2)
        mean = (colour + alpha[..., None] // 2) // np.maximum(alpha, 1)[..., None]
        return np.concatenate([mean, ((alpha + 2) // 4)[..., None]], axis=2).astype(np.uint8)


class Classes(Photo):
    """PNG of colours of classes."""

    def encode(self, picture: Picture) -> bytes:
        """Without loss."""
        return png_bytes(picture)


class Heights(Classes):
    """PNG of heights (`heights_picture`)."""

    def coarser(self, picture: Picture) -> Picture:
        """Means of the known ones of four heights, where two are."""
        fours = heights_of(_fours(picture))
        known = np.isfinite(fours)
        count = known.sum(axis=2)
        mean = np.where(known, fours, 0.0).sum(axis=2) / np.maximum(count, 1)
        return heights_picture(np.where(count >= 2, mean, np.nan))


ORTHO, HEIGHT, SURFACE = "ortho", "height", "surface"
RASTER_LAYERS: Final = {
    ORTHO: RasterLayer(ORTHO, "image/webp", ".webp", Photo(), 0),
    HEIGHT: RasterLayer(HEIGHT, "image/png", ".png", Heights(), 1),
    SURFACE: RasterLayer(SURFACE, "image/png", ".png", Classes(), 1),
}


def heights_picture(height_m: FloatArray) -> Picture:
    """(…, 4) RGBA of heights (…), m: height = 256 R + G + B / 256 - 32768; clear where it is NaN."""
    known = np.isfinite(height_m)
    steps = np.rint((np.where(known, height_m, 0.0) + HEIGHT_ZERO_M) * HEIGHT_STEPS).astype(np.int64)
    rgba = np.stack([steps >> 16, (steps >> 8) & 255, steps & 255, np.full(steps.shape, 255)], axis=-1)
    return np.where(known[..., None], rgba, 0).astype(np.uint8)


def heights_of(picture: Picture) -> FloatArray:
    """The inverse of `heights_picture`: m, NaN where the picture is clear."""
    red, green, blue, alpha = np.moveaxis(picture.astype(np.int64), -1, 0)
    height = ((red << 16) + (green << 8) + blue) / HEIGHT_STEPS - HEIGHT_ZERO_M
    return np.asarray(np.where(alpha > 0, height, np.nan))


def decode_picture(data: bytes, name: str = "tile") -> Picture:
    """RGBA of a tile's bytes. Raises InputError for bytes that are none."""
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if found is None or found.shape[:2] != (RASTER_PX, RASTER_PX):
        raise InputError("is no raster tile or is damaged", file=name, remedy="have the map stitched anew")
    turned = cv2.cvtColor(found, cv2.COLOR_BGRA2RGBA if found.shape[2] == 4 else cv2.COLOR_BGR2RGBA)
    return np.asarray(turned, np.uint8)


def _fours(picture: Picture) -> Picture:
    """(n, n, 4, 4): of each pixel of the next coarser zoom its four."""
    n = len(picture) // 2
    return picture.reshape(n, 2, n, 2, 4).swapaxes(1, 2).reshape(n, n, 4, 4)
