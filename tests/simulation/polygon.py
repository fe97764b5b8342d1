"""Points in polygons, the slow way."""

import numpy as np


def inside(ring: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(N,) which of the points xy (N, 2) lie within a closed ring (M, 2 or 3): an odd number of edges lies to their right."""
    a, b = ring[:-1, :2], ring[1:, :2]
    x, y = xy[:, :1], xy[:, 1:]
    spans = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return np.sum(spans & (x < at), axis=1) % 2 == 1


def distance(ring: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(N,) m from each point to the line of a ring."""
    a, b = ring[:-1, :2], ring[1:, :2]
    d = b - a
    length2 = np.maximum(np.sum(d * d, axis=1), 1e-12)
    t = np.clip(np.sum((xy[:, None] - a) * d, axis=2) / length2, 0, 1)
    return np.linalg.norm(xy[:, None] - a - t[..., None] * d, axis=2).min(axis=1)
