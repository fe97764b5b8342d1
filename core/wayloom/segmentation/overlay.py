"""Overlay of labels on their image in the Cityscapes colours."""

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID, VOID


def overlay(image: NDArray[np.uint8], labels: NDArray[np.uint8], alpha: float = 0.5) -> NDArray[np.uint8]:
    """Blend each class's colour over the image; void pixels stay as they are.

    image    (h, w) grey or (h, w, 3) RGB uint8
    labels   (h, w) uint8 train ids
    alpha    share of the colour, 0 to 1
    returns  (h, w, 3) RGB uint8
    """
    rgb = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image
    share = np.where(labels == VOID, 0.0, alpha).astype(np.float32)[:, :, None]
    blend = rgb + share * (PALETTE_WITH_VOID[labels].astype(np.float32) - rgb)
    return np.rint(blend).astype(np.uint8)
