"""Painting primitives for procedural textures."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayloom.simulation.textures.noise import Field, spectral_noise

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


class Canvas:
    """One texture to be painted: size, random stream, and x (to the right), y (down) in 0 to 1 for every texel."""

    def __init__(self, rng: np.random.Generator, size: int) -> None:
        self.rng = rng
        self.size = size
        centres = (np.arange(size) + 0.5) / size
        self.x: Field = np.broadcast_to(centres[None], (size, size)).astype(np.float32)
        self.y: Field = np.broadcast_to(centres[:, None], (size, size)).astype(np.float32)

    def noise(self, exponent: float, lowest: float = 0.5) -> Field:
        """Fresh `spectral_noise` of the canvas's size."""
        return spectral_noise(self.rng, self.size, exponent, lowest)

    def filled(self, rgb: ArrayLike, shade: Field) -> Image:
        """(n, n, 3) one linear colour times a shade (n, n) around 1."""
        return np.asarray(np.asarray(rgb, np.float32) * shade[..., None], np.float32)


def over(mask: Mask, top: ArrayLike, below: Image) -> Image:
    """`top` (a colour, or an image) where the mask (n, n) is true, `below` elsewhere."""
    return np.asarray(np.where(mask[..., None], np.asarray(top, np.float32), below), np.float32)


def finished(rgb: Image, fourth: ArrayLike) -> Image:
    """(n, n, 4): colour clipped to what a surface can reflect, and gloss (or coverage) in the fourth channel."""
    out = np.empty((*rgb.shape[:2], 4), np.float32)
    out[..., :3] = np.clip(rgb, 0.004, 0.95)
    out[..., 3] = fourth
    return out


def courses(c: Canvas, columns: int, rows: int, joint_x: float, joint_y: float) -> tuple[Mask, Field]:
    """Bricks in running bond: where the joints are, and a random tone for each brick, unit spread."""
    v = c.y * rows
    u = c.x * columns + np.float32(0.5) * (np.floor(v) % 2)
    joints = np.asarray((u % 1 < joint_x) | (v % 1 < joint_y))
    which = (np.floor(u) % columns + columns * np.floor(v)).astype(np.int64)
    return joints, c.rng.normal(0, 1, columns * rows + columns).astype(np.float32)[which]
