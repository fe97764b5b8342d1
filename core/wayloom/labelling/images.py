"""Cache of the voters' images: labels, class scores, small grey images and distance transforms."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.geometry.camera import StereoRig
from wayloom.labelling.settings import LabellingSettings
from wayloom.segmentation.scores import Scores, rest_steps

Image = NDArray[np.uint8]


class LabelImages(Protocol):
    """Label images by voter, (h, w) uint8 train ids: `wayloom.segmentation.keyframe_labels.KeyframeLabels` is one.

    may_be_void : whether any pixel can be void
    is_balanced : whether the network's training weighed rare classes more
    """

    @property
    def may_be_void(self) -> bool: ...

    @property
    def is_balanced(self) -> bool: ...

    def left(self, keyframe: int, /) -> Image: ...
    def right(self, keyframe: int, /) -> Image: ...
    def scores(self, side: str, keyframe: int, /) -> Scores | None: ...
    def small(self, side: str, keyframe: int, /) -> Image: ...


@dataclass(frozen=True, slots=True)
class VoterImages:
    """The images of one voter, each for left and right; the right ones None where it does not vote.

    labels          (h, w) uint8; the right one None where its scores suffice, too
    scores          where they are wanted and there; rest (gh, gw) goes with them (`rest_steps`)
    small           the grey image at half size, where it is wanted
    to_boundary     (h, w) float32 px: distance of every pixel to the nearest label boundary, where it is wanted
    scores_suffice  whether labels are read for the host's own points alone, as no pixel is void and none is near a boundary
    """

    labels: tuple[Image, Image | None]
    scores: tuple[tuple[Scores, NDArray[np.float32]] | None, tuple[Scores, NDArray[np.float32]] | None]
    small: tuple[Image, Image | None] | None
    to_boundary: tuple[NDArray[np.float32], NDArray[np.float32] | None] | None
    scores_suffice: bool


class VoterImageCache:
    """Images of the voters by row, read when asked for; the least recently used beyond `capacity` are dropped."""

    def __init__(
        self, images: LabelImages, right: NDArray[np.bool_], rig: StereoRig, capacity: int, settings: LabellingSettings
    ) -> None:
        """right: (V,) whose right images vote."""
        self._images = images
        self._right = right
        self._size = (rig.camera.height, rig.camera.width)
        self._capacity = capacity
        self._with_small = settings.ncc_power > 0
        self._with_scores = settings.votes == "soft"
        self._with_boundaries = settings.boundary_px > 0
        self._cache: OrderedDict[int, VoterImages] = OrderedDict()

    def __getitem__(self, row: int) -> VoterImages:
        if row not in self._cache:
            self._cache[row] = self._read(row)
            if len(self._cache) > self._capacity:
                self._cache.popitem(last=False)
        self._cache.move_to_end(row)
        return self._cache[row]

    def _read(self, row: int) -> VoterImages:
        both = bool(self._right[row])
        scores = (self._scores("left", row), self._scores("right", row) if both else None)
        scores_suffice = scores[0] is not None and not (self._images.may_be_void or self._with_boundaries)
        left = self._label_image("left", row)
        right = self._label_image("right", row) if both and not scores_suffice else None
        to_boundary = (_to_boundary(left), None if right is None else _to_boundary(right)) if self._with_boundaries else None
        small = (self._images.small("left", row), self._images.small("right", row) if both else None) if self._with_small else None
        return VoterImages((left, right), scores, small, to_boundary, scores_suffice)

    def _label_image(self, side: str, row: int) -> Image:
        image = self._images.left(row) if side == "left" else self._images.right(row)
        if image.shape != self._size:
            raise StageError(f"{side} labels of keyframe {row} are {image.shape}, the camera's are {self._size}; segment again")
        return image

    def _scores(self, side: str, row: int) -> tuple[Scores, NDArray[np.float32]] | None:
        scores = self._images.scores(side, row) if self._with_scores else None
        return None if scores is None else (scores, rest_steps(scores))


def _to_boundary(labels: Image) -> NDArray[np.float32]:
    """(h, w) distance in px of each pixel to the nearest one that has a neighbour of another label."""
    inside = np.ones(labels.shape, np.uint8)
    across, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    inside[:, 1:][across] = inside[:, :-1][across] = 0
    inside[1:][down] = inside[:-1][down] = 0
    return np.asarray(cv2.distanceTransform(inside, cv2.DIST_L2, 3), np.float32)
