"""Halves and gradients of images, and the thresholds of point selection."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import kernel

f32 = np.float32
HISTOGRAM = 100


def halved(image):  # type: ignore[no-untyped-def]
    """(h, w) uint8 to (h // 2, w // 2) float32: means of 2x2 pixels, exactly; an odd last row or column is left out."""
    out = np.empty((image.shape[0] // 2, image.shape[1] // 2), np.float32)
    fill_halved(image, out)
    return out


@kernel
def fill_halved(image, out):  # type: ignore[no-untyped-def]
    """halved into out."""
    h, w = out.shape
    for y in range(h):
        upper, lower, row = image[2 * y], image[2 * y + 1], out[y]
        for x in range(w):
            total = np.int32(upper[2 * x]) + np.int32(upper[2 * x + 1]) + np.int32(lower[2 * x]) + np.int32(lower[2 * x + 1])
            row[x] = f32(0.25) * f32(total)


def gradient_size(image):  # type: ignore[no-untyped-def]
    """(h, w) uint8 to (h, w) float32: length of the central-difference gradient, 0 in the outermost pixels."""
    out = np.empty(image.shape, np.float32)
    fill_gradient_size(image, out)
    return out


@kernel
def fill_gradient_size(image, out):  # type: ignore[no-untyped-def]
    """gradient_size into out (h, w)."""
    h, w = image.shape
    out[0], out[h - 1] = f32(0), f32(0)
    for y in range(1, h - 1):
        out[y, 0] = out[y, w - 1] = f32(0)
        for x in range(1, w - 1):
            gx = np.int32(image[y, x + 1]) - np.int32(image[y, x - 1])  # uint8 differences would wrap
            gy = np.int32(image[y + 1, x]) - np.int32(image[y - 1, x])
            out[y, x] = f32(0.5) * math.sqrt(f32(gx * gx + gy * gy))


def block_medians(size, block):  # type: ignore[no-untyped-def]
    """Median of the gradient (whole grey levels under 100) over every second pixel of each block of `block` px:
    (ceil(h / block), ceil(w / block)) float32."""
    h, w = size.shape
    out = np.empty(((h + block - 1) // block, (w + block - 1) // block), np.float32)
    fill_block_medians(size, block, np.empty(HISTOGRAM, np.int64), out)
    return out


@kernel
def fill_block_medians(size, block, histogram, out):  # type: ignore[no-untyped-def]
    """block_medians into out, with working space histogram (100,)."""
    h, w = size.shape
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            histogram[:] = 0
            pixels = 0
            for y in range(r * block, min(h, (r + 1) * block), 2):
                for x in range(c * block, min(w, (c + 1) * block), 2):
                    histogram[min(HISTOGRAM - 1, int(size[y, x]))] += 1
                    pixels += 1
            k, below = 0, histogram[0]
            while below * 2 < pixels:
                k += 1
                below += histogram[k]
            out[r, c] = k
