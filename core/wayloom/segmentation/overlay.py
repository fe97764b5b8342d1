"""Overlay of labels on their image in the Cityscapes colours."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID, PERSONS, VOID

HIDDEN_MARGIN_SHARE: Final = 0.008
"""Of the image's width, around persons: labels are rarely exact at their borders."""


def overlay(image: NDArray[np.uint8], labels: NDArray[np.uint8], alpha: float = 0.5) -> NDArray[np.uint8]:
    """Blend each class's colour over the image; void pixels stay as they are.

    image    (h, w) grey or (h, w, 3) RGB uint8
    labels   (h, w) uint8 train ids
    alpha    share of the colour, 0 to 1
    returns  (h, w, 3) RGB uint8
    """
    level = np.arange(256, dtype=np.uint8)[:, None]
    share = np.where(np.arange(256) == VOID, 0.0, alpha).astype(np.float32)[:, None, None]
    blend = np.rint(level + share * (PALETTE_WITH_VOID[:, None].astype(np.float32) - level)).astype(np.uint8)
    row = labels.astype(np.int64) << 8
    channels = [image if image.ndim == 2 else image[:, :, k] for k in range(3)]
    return np.stack([blend[..., k].ravel().take(row + channel) for k, channel in enumerate(channels)], axis=2)


def without_persons(image: NDArray[np.uint8], labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image with persons and riders, and a margin around them, painted over in the colour of their class.

    image    (h, w) grey or (h, w, 3) RGB uint8
    labels   (h, w) uint8 train ids
    returns  (h, w, 3) RGB uint8
    """
    rgb = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image.copy()
    reach = round(HIDDEN_MARGIN_SHARE * image.shape[1])
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    hidden = cv2.dilate(np.isin(labels, PERSONS).astype(np.uint8), disc) > 0
    rgb[hidden] = PALETTE_WITH_VOID[PERSONS[0]]
    return rgb
