"""Packing of looks, each by itself: so little room that those of an hour are held in memory until their file is written."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import Looks
from wayloom.geometry.camera import PinholeCamera

Image = NDArray[np.uint8]
LEVEL: Final = 9
"""Of the packing: it takes a tenth of the stage's time."""


@dataclass(frozen=True, slots=True)
class PackedLooks:
    """Looks as they lie in their file; `packed` has each one's (`pack`), the rest is as of `Looks`."""

    camera: PinholeCamera
    sigma: float
    frame: NDArray[np.uint32]
    packed: Sequence[bytes]

    def __len__(self) -> int:
        return len(self.frame)

    def looks(self) -> Looks:
        """All of them. Raises ValueError or zlib.error where one is damaged."""
        return unpacked(self.camera, self.sigma, self.frame, self.packed)


def pack(near: Image, far: Image, kinds: Image) -> bytes:
    """The bytes of one look: the planes near, far - near and kinds (h, w)."""
    return zlib.compress(np.stack([near, far - near, kinds]).tobytes(), LEVEL)


def packed_looks(looks: Looks) -> PackedLooks:
    """Each of the looks packed."""
    packed = [pack(*planes) for planes in zip(looks.near, looks.far, looks.kinds, strict=True)]
    return PackedLooks(looks.camera, looks.sigma, looks.frame, packed)


def unpacked(camera: PinholeCamera, sigma: float, frame: NDArray[np.uint32], packed: Sequence[bytes | memoryview]) -> Looks:
    """The looks of these frames (n,). Raises ValueError or zlib.error where one is damaged."""
    planes = b"".join(zlib.decompress(one) for one in packed)
    found = np.frombuffer(planes, np.uint8).reshape(len(frame), 3, camera.height, camera.width)
    return Looks(camera, sigma, frame, found[:, 0], found[:, 0] + found[:, 1], found[:, 2])
