"""Stereo frames while they are processed: the pair as the log gives it, and the pair with its pyramid and predicted pose."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.tracking.pyramid import Pyramid

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]


class GreyPair:
    """A pair as the odometry takes it: grey, the right image read when it is first asked for (at keyframes), where the log can
    give one side alone.

    index, t_ns  as of StereoFrame
    left         (h, w) uint8
    images       the left one's pyramid, once it is built
    """

    __slots__ = ("_read_right", "_right", "images", "index", "left", "t_ns")

    def __init__(self, index: int, t_ns: int, left: Image, read_right: Callable[[], Image]) -> None:
        self.index, self.t_ns, self.left = index, t_ns, left
        self.images: Pyramid | None = None
        self._read_right = read_right
        self._right: Image | None = None

    @property
    def right(self) -> Image:
        """(h, w) uint8. Raises LogError as the log."""
        if self._right is None:
            self._right = self._read_right()
        return self._right


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of the drive on its way through the odometry.

    pair        its images as the log gives them; the right one is read when it is asked for
    images      the left image's pyramid
    T_predicted (4, 4) T_cam_world as predicted from the frames before it
    """

    pair: GreyPair
    images: Pyramid
    T_predicted: FloatArray

    @property
    def index(self) -> int:
        """Number of the frame in the drive, from 0."""
        return self.pair.index

    @property
    def t_ns(self) -> int:
        """Time stamp, ns."""
        return self.pair.t_ns

    @property
    def left(self) -> Image:
        """(h, w) uint8, the left image."""
        return self.pair.left
