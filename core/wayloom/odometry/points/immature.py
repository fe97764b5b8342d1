"""Immature points: depth by epipolar search and depth filtering beside the window, with the poses fixed.

What static stereo finds but the window has no room for waits with a known depth; much of it never joins the window. What stereo
does not find (horizontal edges, repeated texture) is searched along its epipolar line in every later keyframe (Engel et al. 2018,
sec. 3.1 and 3.2), until its depth is sure enough to make it live. Each further keyframe improves a known depth, with the poses
fixed. When their host leaves the window, those whose depth is known become points of the map like the others.
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend.window import ImmaturePoints, Window, chosen, indices_of, joined, new_points
from wayloom.odometry.kernels.arrays import Rig, Robust
from wayloom.odometry.kernels.tracing import MISFIT, TRACED, trace_points, update_depths

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
NEAREST_M = 2.0
"""Where the search for an unknown depth ends."""
UNIQUENESS = 3.0
"""Least ratio of the second best squared distance to the best (Engel et al. 2018: 3)."""
MAX_LENGTH_PX = 80.0
"""Longest stretch of an epipolar line that is searched."""
LOOK_BACK = 2
"""Keyframes before its own in which a point is searched for."""
START_INFORMATION = 1e-3
"""Of a depth that has just been found, at least; what the images tell is a thousand times that and more."""
MAX_FAILURES = 2
"""Searches in which nothing fits, after which a point is forgotten."""
SURE = 0.25
"""Half an interval over the inverse depth, below which a depth is known."""


def known(waiting: ImmaturePoints) -> BoolArray:
    """(N,) whose depth is known."""
    return np.asarray(waiting.information > 0)


def of_pixels(
    window: Window, pixels: IntArray, rho: FloatArray, first_id: int, gradient_scale: float, rig: Rig, robust: Robust
) -> ImmaturePoints:
    """Immature points at pixels (n, 2) of the newest keyframe, numbered from first_id; rho (n,) 1/m from static stereo, 0 where it
    is unknown; those whose patch does not fit their own right image are left out."""
    n = len(pixels)
    points = new_points(window, pixels, rho, gradient_scale)
    fresh = ImmaturePoints(
        points, np.arange(first_id, first_id + n), np.zeros(n), np.full(n, 1.0 / NEAREST_M), np.zeros(n), np.zeros(n, np.int64),
        np.zeros(n, np.int64),
    )  # fmt: skip
    seen = _update(window, fresh, np.flatnonzero(rho > 0), len(window) - 1, rig, robust)[:, 0]
    fits = in_rows(n, seen - first_id)
    fresh.information[fits] = np.maximum(fresh.information[fits], START_INFORMATION)  # their depth is known, whatever it weighs
    points.has_static[:] = fits
    return part(fresh, (points.rho == 0) | fits)


def in_rows(count: int, rows: IntArray) -> BoolArray:
    """(count,) mask of these rows."""
    mask = np.zeros(count, np.bool_)
    mask[rows] = True
    return mask


def part(points: ImmaturePoints, rows: IntArray | BoolArray) -> ImmaturePoints:
    """The points in these rows, or in this mask."""
    rows = indices_of(rows)
    return ImmaturePoints(chosen(points.points, rows), *(getattr(points, name).take(rows) for name in ImmaturePoints.__slots__[1:]))


def add(window: Window, fresh: ImmaturePoints) -> None:
    """Let points of the newest keyframe wait."""
    old = window.immature
    window.immature = ImmaturePoints(
        joined(old.points, fresh.points),
        *(np.append(getattr(old, name), getattr(fresh, name)) for name in ImmaturePoints.__slots__[1:]),
    )


def keep(window: Window, mask: BoolArray) -> None:
    """Forget those that are not in mask (N,)."""
    if not mask.all():
        window.immature = part(window.immature, mask)


def _update(window: Window, waiting: ImmaturePoints, rows: IntArray, target: int, rig: Rig, robust: Robust) -> IntArray:
    """What keyframe `target` tells of the points `rows` (n,) of known depth; returns the observations (m, 3) there: point's
    number, row of the keyframe, what is noted of it (`arrays.RIGHT` …)."""
    state, agrees = np.zeros((2, len(rows)), np.int64)
    update_depths(
        window.images, rig, window.frames, waiting.points, rows, target, window.disparity_bias[0], robust, waiting.information,
        state, agrees,
    )  # fmt: skip
    seen = np.flatnonzero(state == TRACED)
    out = np.empty((len(seen), 3), np.int64)
    out[:, 0], out[:, 1], out[:, 2] = waiting.id.take(rows.take(seen)), window.keyframe[target], agrees.take(seen)
    return out


def trace(window: Window, rig: Rig, robust: Robust) -> IntArray:
    """Search and improve depths: of older keyframes' points in the newest keyframe, of its own in those before it. Points that fit
    nowhere are forgotten. Returns the observations (m, 3) as _update."""
    newest, host = len(window) - 1, window.immature.points.host
    observations = [_look(window, np.flatnonzero(host < newest), newest, rig, robust)]
    own = np.flatnonzero(host == newest)
    observations += [_look(window, own, t, rig, robust) for t in range(newest - 1, max(newest - 1 - LOOK_BACK, -1), -1)]
    keep(window, window.immature.failures < MAX_FAILURES)
    return np.concatenate(observations)


def _look(window: Window, rows: IntArray, target: int, rig: Rig, robust: Robust) -> IntArray:
    """Search those of the points `rows` (n,) of unknown depth in keyframe `target`, and take what it tells of the others."""
    p = window.immature
    unknown = rows[p.information[rows] == 0]
    state = np.zeros(len(unknown), np.int64)
    trace_points(
        window.images, rig, window.frames, p.points, unknown, target, p.low, p.high, UNIQUENESS, MAX_LENGTH_PX, robust, state
    )
    p.failures[unknown] += state == MISFIT
    p.traced[unknown] += state == TRACED
    found = unknown[state == TRACED]
    p.information[found[(p.high - p.low)[found] < 2 * SURE * p.points.rho[found]]] = START_INFORMATION
    return _update(window, p, rows[p.information[rows] > 0], target, rig, robust)


def take(window: Window, gone: BoolArray) -> ImmaturePoints:
    """Take those in gone (N,) out of the window; returns the ones of known depth."""
    taken = part(window.immature, gone & known(window.immature))
    keep(window, ~gone)
    return taken
