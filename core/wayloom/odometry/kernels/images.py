"""Gradients of images and the thresholds of point selection."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import jit

f32 = np.float32
HISTOGRAM = 100


@jit
def with_gradient(image):  # type: ignore[no-untyped-def]
    """(h, w) float32 to (h, w, 3) float32: intensity, d/du, d/dv by central differences, one-sided halves at the border."""
    h, w = image.shape
    out = np.empty((h, w, 3), np.float32)
    for y in range(h):
        above, here, below, row = image[max(y - 1, 0)], image[y], image[min(y + 1, h - 1)], out[y]
        for x in range(1, w - 1):
            row[x, 0] = here[x]
            row[x, 1] = f32(0.5) * (here[x + 1] - here[x - 1])
            row[x, 2] = f32(0.5) * (below[x] - above[x])
        for x in (0, w - 1):
            row[x, 0] = here[x]
            row[x, 1] = f32(0.5) * (here[min(x + 1, w - 1)] - here[max(x - 1, 0)])
            row[x, 2] = f32(0.5) * (below[x] - above[x])
    return out


@jit
def gradient_size(image):  # type: ignore[no-untyped-def]
    """(h, w) uint8 to (h, w) float32: length of the central-difference gradient, 0 in the outermost pixels."""
    h, w = image.shape
    out = np.zeros((h, w), np.float32)
    for y in range(1, h - 1):
        for x in range(1, w - 1):
            gx = np.int32(image[y, x + 1]) - np.int32(image[y, x - 1])  # uint8 differences would wrap
            gy = np.int32(image[y + 1, x]) - np.int32(image[y - 1, x])
            out[y, x] = f32(0.5) * math.sqrt(f32(gx * gx + gy * gy))
    return out


@jit
def block_medians(size, block):  # type: ignore[no-untyped-def]
    """Median of the gradient (whole grey levels under 100) over every second pixel of each block of `block` px:
    (ceil(h / block), ceil(w / block)) float32."""
    h, w = size.shape
    out = np.zeros(((h + block - 1) // block, (w + block - 1) // block), np.float32)
    histogram = np.zeros(HISTOGRAM, np.int64)
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
    return out
