"""Images of a drive that are looked at twice, once for its own lens and once as it is tracked, decoded once."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.types import DriveLog
from wayloom.odometry.parts.log_view import GreyLogView

Image = NDArray[np.uint8]
MOST_BYTES: Final = 64_000_000
"""That are held: a hundred and forty images of 1241 x 376 px."""


class HeldImages(GreyLogView):
    """A log whose images stay in memory as they are decoded, as many as there is room for, until `release`; from then on each is
    let go as it is taken. Of a log that gives one grey side at a time. Several threads may read."""

    def __init__(self, log: DriveLog) -> None:
        super().__init__(log, 0, len(log))
        self._held: dict[tuple[int, bool], Image] = {}
        self._room, self._holds = MOST_BYTES, True

    def grey_side(self, index: int, right: bool) -> Image:
        """(h, w) as of the log, not to be written to while images are held."""
        key = index, bool(right)
        image = self._held.get(key) if self._holds else self._held.pop(key, None)
        if image is None:
            image = super().grey_side(index, right)
            if self._holds and image.nbytes <= self._room:
                self._held[key] = image
                self._room -= image.nbytes
        return image

    def release(self) -> None:
        """Hold no more images, and those that are held until they are taken only."""
        self._holds = False


def held_images(log: DriveLog) -> DriveLog:
    """The log as one whose images are held; itself where it cannot give one grey side at a time."""
    return HeldImages(log) if hasattr(type(log), "grey_side") else log


def release(log: DriveLog) -> None:
    """What `held_images` holds is let go as it is taken."""
    if isinstance(log, HeldImages):
        log.release()
