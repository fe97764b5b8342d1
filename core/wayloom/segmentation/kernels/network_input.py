"""Images in the order and scale of a network's input."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy", nogil=True)
def scaled_planes(image, levels, planes):  # type: ignore[no-untyped-def]
    """Fill in one image of a batch, channels first, each pixel's bytes looked up.

    image   (h, w, 3) uint8
    levels  (3, 256) float32: what each byte of a channel is in the network's input
    planes  (3, h, w) float32, filled
    """
    height, width, _ = image.shape
    for v in range(height):
        for c in range(3):
            for u in range(width):
                planes[c, v, u] = levels[c, image[v, u, c]]


@njit(cache=True, error_model="numpy", nogil=True)
def scaled_grey(image: NDArray[np.uint8], levels: NDArray[np.float32], planes: NDArray[np.float32]) -> None:
    """The same of a grey image, which stands for three equal channels. image : (h, w) uint8."""
    height, width = image.shape
    for v in range(height):
        for c in range(3):
            for u in range(width):
                planes[c, v, u] = levels[c, image[v, u]]


@njit(cache=True, error_model="numpy", nogil=True)
def scaled_pixels(image, levels, pixels):  # type: ignore[no-untyped-def]
    """The same, channels last. pixels : (h, w, 3) float32, filled."""
    height, width, _ = image.shape
    for v in range(height):
        for u in range(width):
            for c in range(3):
                pixels[v, u, c] = levels[c, image[v, u, c]]
