"""Centre lines for driving and walking: lanes offset from chains of street nodes, with rounded and eased corners."""

from dataclasses import dataclass

import numpy as np

from wayloom.simulation.city.streets import F64

SAMPLE_M = 0.1
EASE_M = 8.0
"""Over how many metres heading is smoothed, as a driver steers."""
LANE_M, CYCLE_LANE_M = 1.75, 3.3
AVENUE_LANE_M, TRAM_LANE_M = 4.9, 1.75
TURN_RADIUS_M = 9.0


@dataclass(frozen=True, slots=True)
class Path:
    """s (N,) m from the start, xy (N, 2) m, yaw (N,) rad, unwrapped."""

    s: F64
    xy: F64
    yaw: F64

    @property
    def length_m(self) -> float:
        """From start to end."""
        return float(self.s[-1])

    def at(self, s_m: float) -> tuple[float, float, float]:
        """x, y, yaw at s_m, held at the ends."""
        x, y = (float(np.interp(s_m, self.s, self.xy[:, k])) for k in (0, 1))
        return x, y, float(np.interp(s_m, self.s, self.yaw))


def lane_path(nodes: F64, right_m: float, radius_m: float = TURN_RADIUS_M, closed: bool = False) -> Path:
    """The line right_m to the right of the chain of nodes (N, 2)."""
    return _path(_sampled(_rounded(_shifted(nodes, right_m, closed), radius_m, closed)), closed)


def _shifted(nodes: F64, right_m: float, closed: bool) -> F64:
    """Every side of the chain moved to the right; corners where neighbouring sides meet."""
    loop = np.vstack([nodes, nodes[:1]]) if closed else nodes
    d = np.diff(loop, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    right = np.column_stack([d[:, 1], -d[:, 0]]) * right_m
    before = np.vstack([right[-1:] if closed else right[:1], right])
    after = np.vstack([right, right[:1] if closed else right[-1:]])
    middle = before + after  # along the bisector; its length makes both sides keep their distance
    shift = middle * (2 * right_m**2 / np.sum(middle**2, axis=1, keepdims=True)) if right_m else middle
    return np.asarray((loop + shift)[: len(nodes)])


def _rounded(corners: F64, radius_m: float, closed: bool) -> F64:
    """Corners replaced by arcs, as far as the sides are long enough."""
    count = len(corners)
    out = [] if closed else [corners[:1]]
    for k in range(count) if closed else range(1, count - 1):
        before, here, after = corners[k - 1], corners[k], corners[(k + 1) % count]
        a, b = before - here, after - here
        la, lb = np.hypot(*a), np.hypot(*b)
        a, b = a / la, b / lb
        half = 0.5 * np.arccos(np.clip(a @ b, -1, 1))
        tangent = min(radius_m / np.tan(half), 0.48 * la, 0.48 * lb)
        if np.pi / 2 - half < 1e-3:
            out.append(here[None])
            continue
        radius = tangent * np.tan(half)
        middle = (a + b) / np.linalg.norm(a + b)
        centre, start, end = here + middle * radius / np.sin(half), here + a * tangent, here + b * tangent
        a0, a1 = np.arctan2(*(start - centre)[::-1]), np.arctan2(*(end - centre)[::-1])
        angle = a0 + np.linspace(0, (a1 - a0 + np.pi) % (2 * np.pi) - np.pi, 16)
        out.append(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    out += [] if closed else [corners[-1:]]
    line = np.vstack(out)
    return np.vstack([line, line[:1]]) if closed else line


def rounded_line(corners: F64, radius_m: float) -> F64:
    """A line of corners (N, 2) with arcs instead of its inner ones."""
    return _rounded(corners, radius_m, False)


def eased_line(line: F64, before: F64, after: F64, step_m: float, ease_m: float = 4.0) -> F64:
    """(M, 2) points every step_m or so along a line, its bends eased over ease_m; before and after it goes on straight, along the
    directions (2,) given. Its ends stay where they are if its last ease_m / 2 are straight."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(2, round(s[-1] / step_m)) + 1
    even = np.linspace(0.0, s[-1], count)
    step = even[1]
    points = np.column_stack([np.interp(even, s, line[:, k]) for k in (0, 1)])
    half = int(ease_m / step / 2)
    far = step * np.arange(1, half + 1)[:, None]
    padded = np.vstack([points[0] - before * far[::-1], points, points[-1] + after * far])
    window = np.hanning(2 * half + 3)[1:-1]
    return np.column_stack([np.convolve(padded[:, k], window / window.sum(), "valid") for k in (0, 1)])


def _sampled(line: F64) -> F64:
    """A point every SAMPLE_M along a line of corners."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, s[-1], SAMPLE_M)
    return np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)])


def _path(points: F64, closed: bool) -> Path:
    """Points eased by a Hann window, with length and heading."""
    width = int(EASE_M / SAMPLE_M) | 1
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()
    pad = width // 2
    if closed:
        padded = np.vstack([points[-pad:], points, points[:pad]])
    else:  # carry the line straight on beyond its ends
        k = np.arange(1, pad + 1)[:, None]
        padded = np.vstack([points[0] - (points[1] - points[0]) * k[::-1], points, points[-1] + (points[-1] - points[-2]) * k])
    xy = np.column_stack([np.convolve(padded[:, k], window, "valid") for k in (0, 1)])
    if closed:
        xy = np.vstack([xy, xy[:1]])
    step = np.diff(xy, axis=0)
    yaw = np.unwrap(np.arctan2(np.gradient(xy[:, 1]), np.gradient(xy[:, 0])))
    return Path(np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))]), xy, yaw)
