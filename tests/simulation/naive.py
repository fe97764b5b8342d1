"""Slow, obvious twins of the drawing kernels."""

import numpy as np


def ray_hits(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance along direction (3,) at which a ray meets each triangle (T, 3, 3), inf where it does not (Moeller-Trumbore)."""
    p0, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, e2)
    det = np.sum(e1 * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - p0
        l1 = np.sum(s * p, axis=1) / det
        q = np.cross(s, e1)
        l2 = q @ direction / det
        t = np.sum(e2 * q, axis=1) / det
        hit = (np.abs(det) > 1e-14) & (l1 >= 0) & (l2 >= 0) & (l1 + l2 <= 1) & (t > 0)
    return np.where(hit, t, np.inf)


def pixel_ray(u: float, v: float, fx: float, fy: float, cx: float, cy: float, T_world_cam: np.ndarray) -> np.ndarray:
    """Direction (3,) of pixel (u, v) in the world, of camera depth 1."""
    return T_world_cam[:3, :3] @ np.array([(u - cx) / fx, (v - cy) / fy, 1.0])


def texture_at(tex, layer: int, level: int, u: float, v: float) -> np.ndarray:
    """(4,) bilinear colour and fourth channel of one level, from its image."""
    size = tex.size >> level
    first = int(tex.offsets[level]) + layer * size * size
    image = tex.texels[first : first + size * size].reshape(size, size, 4).astype(float) / 255.0
    x, y = u * size - 0.5, v * size - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    ax, ay = x - x0, y - y0
    get = lambda i, j: image[(y0 + j) % size, (x0 + i) % size]  # noqa: E731
    mixed = (get(0, 0) * (1 - ax) + get(1, 0) * ax) * (1 - ay) + (get(0, 1) * (1 - ax) + get(1, 1) * ax) * ay
    return np.array([*mixed[:3] ** 2, mixed[3]])
