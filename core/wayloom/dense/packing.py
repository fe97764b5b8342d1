"""Packing of looks, each by itself."""

import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import Looks
from wayloom.files.growing_arrays import GrowingArray
from wayloom.geometry.camera import PinholeCamera

Image = NDArray[np.uint8]
LEVEL: Final = 9
"""Of the packing: it takes a tenth of the stage's time."""


@dataclass(frozen=True, slots=True)
class PackedLooks:
    """n looks as they lie in their file, the one behind the other: those of row k (`pack`) are packed[start[k]:start[k + 1]].

    start (n + 1,) int64; packed uint8, in memory or, of a long drive, in a file (`wayloom.files.growing_arrays`); the rest is as of
    `Looks`
    """

    camera: PinholeCamera
    sigma: float
    frame: NDArray[np.uint32]
    start: NDArray[np.int64]
    packed: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.frame)

    def looks(self) -> Looks:
        """All of them. Raises ValueError or zlib.error where one is damaged."""
        each = [self.packed[start:end].data for start, end in itertools.pairwise(self.start.tolist())]
        return unpacked(self.camera, self.sigma, self.frame, each)


class Packing:
    """Packed looks, the one after the other."""

    def __init__(self) -> None:
        self._ends = [0]
        self._packed = GrowingArray(np.uint8)

    def __len__(self) -> int:
        return len(self._ends) - 1

    def append(self, one: bytes) -> None:
        """The next look, of `pack`. Raises OSError where the disk is full."""
        self._packed.append(np.frombuffer(one, np.uint8))
        self._ends.append(len(self._packed))

    def of_frames(self, camera: PinholeCamera, sigma: float, frame: NDArray[np.uint32]) -> PackedLooks:
        """All of them, of these frames (n,)."""
        return PackedLooks(camera, sigma, frame, np.array(self._ends, np.int64), self._packed.array())


def pack(near: Image, far: Image, kinds: Image) -> bytes:
    """The bytes of one look: the planes near, far - near and kinds (h, w)."""
    return zlib.compress(np.stack([near, far - near, kinds]).tobytes(), LEVEL)


def packed_looks(looks: Looks) -> PackedLooks:
    """Each of the looks packed."""
    packing = Packing()
    for planes in zip(looks.near, looks.far, looks.kinds, strict=True):
        packing.append(pack(*planes))
    return packing.of_frames(looks.camera, looks.sigma, looks.frame)


def unpacked(camera: PinholeCamera, sigma: float, frame: NDArray[np.uint32], packed: Sequence[bytes | memoryview]) -> Looks:
    """The looks of these frames (n,). Raises ValueError or zlib.error where one is damaged."""
    planes = b"".join(zlib.decompress(one) for one in packed)
    found = np.frombuffer(planes, np.uint8).reshape(len(frame), 3, camera.height, camera.width)
    return Looks(camera, sigma, frame, found[:, 0], found[:, 0] + found[:, 1], found[:, 2])
