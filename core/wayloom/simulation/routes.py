"""How a vehicle goes along its path, at any moment: poses smooth enough that an IMU can be derived from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from wayloom.simulation.paths import Path
from wayloom.simulation.streets import F64
from wayloom.simulation.terrain import Terrain

SPLINE_DEGREE = 5
KNOT_M = 1.0
"""Distance of the points through which a route's line is laid."""
SIDEWAYS_M_S2 = 2.6
"""Sideways acceleration up to which a driver takes a corner."""
ROLL_RAD, PITCH_RAD, HEAVE_M = 0.005, 0.006, 0.010
"""Amplitudes of the body's sway on an uneven road."""
ROLL_PER_M_S2, PITCH_PER_M_S2 = 0.004, -0.004
"""The body leans out of corners, and dips its nose when braking: rad for each m/s^2."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line over the ground: x, y (m) as a spline of the way s along it (m); four times continuously differentiable."""

    xy: BSpline
    length_m: float
    closed: bool

    def at(self, s_m: F64, derivative: int = 0) -> F64:
        """(M, 2) the place, or its derivative by s; beyond the ends of an open line it goes on straight."""
        if self.closed:
            return np.asarray(self.xy(np.mod(s_m, self.length_m), derivative))
        inside = np.clip(s_m, 0.0, self.length_m)
        beyond = np.asarray(s_m - inside)
        if derivative > 1:
            return np.asarray(self.xy(inside, derivative) * (beyond == 0)[:, None])
        straight = self.xy(inside, 1)
        return np.asarray(straight if derivative else self.xy(inside) + beyond[:, None] * straight)

    def curvature(self, s_m: F64) -> F64:
        """(M,) 1/m, positive to the left."""
        first, second = self.at(s_m, 1), self.at(s_m, 2)
        return np.asarray((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.sum(first**2, axis=1) ** 1.5)


def smooth_line(s_m: F64, xy: F64, closed: bool = False) -> Line:
    """The spline through points xy (N, 2) at increasing s (N,). Of a closed line the last point is the first again."""
    if closed:
        xy = np.vstack([xy[:-1], xy[:1]])
        return Line(make_interp_spline(s_m, xy, k=SPLINE_DEGREE, bc_type="periodic"), float(s_m[-1]), True)
    return Line(make_interp_spline(s_m, xy, k=SPLINE_DEGREE), float(s_m[-1]), False)


def line_of(path: Path, closed: bool = False) -> Line:
    """The line through a path's points, one every KNOT_M or so."""
    count = max(SPLINE_DEGREE + 2, round(path.length_m / KNOT_M) + 1)
    s = np.linspace(0.0, path.length_m, count)
    return smooth_line(s, np.column_stack([np.interp(s, path.s, path.xy[:, k]) for k in (0, 1)]), closed)


@dataclass(frozen=True, slots=True)
class Route:
    """A drive from start_s to end_s (s since the city's time zero), or, with lap_s, around and around.

    line     where it goes
    way      the way along the line (m) as a spline of time; within one lap where there are laps
    ground   the hills below
    """

    line: Line
    way: BSpline
    ground: Terrain
    start_s: float
    end_s: float
    lap_s: float | None = None

    @property
    def duration_s(self) -> float:
        """Of the drive, or of one lap."""
        return self.end_s - self.start_s

    @property
    def length_m(self) -> float:
        """Driven from start to end, or in one lap."""
        return float(self.way(self.end_s) - self.way(self.start_s))

    def travelled(self, t_s: ArrayLike, derivative: int = 0) -> F64:
        """(M,) m along the line at times t_s (M,), or its derivative by time (1 speed, 2 acceleration along the way).

        Before the start and after the end the vehicle stands still, unless it goes in laps.
        """
        t = np.atleast_1d(np.asarray(t_s, float))
        if self.lap_s is None:
            inside = np.clip(t, self.start_s, self.end_s)
            return np.asarray(self.way(inside, derivative) * ((t == inside) | (derivative == 0)))
        laps = np.floor((t - self.start_s) / self.lap_s)
        way = self.way(t - laps * self.lap_s, derivative)
        return np.asarray(way + laps * self.length_m if derivative == 0 else way)

    def places(self, t_s: ArrayLike) -> F64:
        """(M, 2) x, y m."""
        return self.line.at(self.travelled(t_s))

    def pose(self, t_s: ArrayLike) -> F64:
        """T_enu_body (M, 4, 4) at times t_s (M,): x forward, y left, z up, origin on the ground under the left camera.

        The body rolls, pitches and heaves on the uneven road, leans out of corners and dips when braking. Its place is twice
        continuously differentiable, its attitude too. A lap's poses repeat exactly.
        """
        s, v, a = (self.travelled(t_s, k) for k in range(3))
        xy, along, bend = self.line.at(s), self.line.at(s, 1), self.line.curvature(s)
        T = self.ground.poses_on_ground(xy[:, 0], xy[:, 1], np.arctan2(along[:, 1], along[:, 0]))
        return np.asarray(T @ self._sway(s, a, v * v * bend))

    def _sway(self, s: F64, braking: F64, sideways: F64) -> F64:
        """(M, 4, 4) of the body over its wheels: T_wheels_body. A closed line gets waves that fit its length."""
        w = s if not self.line.closed else s * self._fitted()
        roll = ROLL_RAD * np.sin(0.55 * w + 0.4) + ROLL_PER_M_S2 * sideways
        pitch = PITCH_RAD * (np.sin(0.9 * w) + 0.5 * np.sin(2.3 * w + 1)) + PITCH_PER_M_S2 * braking
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        out = np.zeros((len(s), 4, 4))
        out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = cp, sp * sr, sp * cr
        out[:, 1, 1], out[:, 1, 2] = cr, -sr
        out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = -sp, cp * sr, cp * cr
        out[:, 2, 3], out[:, 3, 3] = HEAVE_M * np.sin(1.1 * w), 1.0
        return out

    def _fitted(self) -> float:
        """Stretches the way a little, so that all waves of the sway, whose frequencies are multiples of 0.05/m, close on a lap."""
        base = 2 * np.pi / 0.05
        return max(1.0, round(self.line.length_m / base)) * base / self.line.length_m


def timed(t_s: F64, way_m: F64) -> BSpline:
    """The way along a line (N,) m at times t_s (N,) as a spline of time; four times continuously differentiable."""
    return make_interp_spline(t_s, way_m, k=SPLINE_DEGREE)


def nearest_s(path: Path, point: NDArray[np.float64]) -> float:
    """Where on the path, m from its start, it comes nearest to a point (2,) m."""
    return float(path.s[np.argmin(np.linalg.norm(path.xy - point, axis=1))])


def fastest_along(line: Line, s_m: F64, fastest_m_s: float) -> F64:
    """(M,) m/s: how fast a driver takes each place of a line."""
    return np.asarray(np.minimum(fastest_m_s, np.sqrt(SIDEWAYS_M_S2 / np.maximum(np.abs(line.curvature(s_m)), 1e-6))))


def driven_alone(
    line: Line, ground: Terrain, start_m: float, start_s: float, duration_s: float, fastest_m_s: float, step_s: float = 0.1
) -> Route:
    """A drive from start_m on an empty street: as fast as corners allow, with braking and pulling away of at most 2 m/s^2 or so."""
    s = np.arange(0.0, line.length_m, 0.5)
    speed = _reachable(s, fastest_along(line, s, fastest_m_s))
    t = start_s + step_s * np.arange(-EASE_STEPS, int(np.ceil(duration_s / step_s)) + EASE_STEPS + 1)
    way = np.empty(len(t))
    at = start_m - EASE_STEPS * step_s * float(np.interp(start_m, s, speed))
    for k in range(len(t)):
        way[k] = at
        at += step_s * float(np.interp(at, s, speed))
    return Route(line, timed(t, eased(way)), ground, start_s, start_s + duration_s)


EASE_STEPS = 8


def eased(way_m: F64) -> F64:
    """The way at even time steps, smoothed over 2 EASE_STEPS + 1 of them, so that acceleration changes gently."""
    window = np.hanning(2 * EASE_STEPS + 3)[1:-1]
    before = way_m[0] + (way_m[1] - way_m[0]) * np.arange(-EASE_STEPS, 0)
    after = way_m[-1] + (way_m[-1] - way_m[-2]) * np.arange(1, EASE_STEPS + 1)
    return np.asarray(np.convolve(np.concatenate([before, way_m, after]), window / window.sum(), "valid"))


def _reachable(s: F64, limit: F64, accelerate: float = 1.8, brake: float = 2.0) -> F64:
    """The limit (N,) m/s lowered to what bounded acceleration allows: v^2 changes by at most 2 a ds."""
    v2, ds = limit**2, np.diff(s)
    for k in range(len(ds)):
        v2[k + 1] = min(v2[k + 1], v2[k] + 2 * accelerate * ds[k])
    for k in range(len(ds) - 1, -1, -1):
        v2[k] = min(v2[k], v2[k + 1] + 2 * brake * ds[k])
    return np.asarray(np.sqrt(v2))


def length_of(points: Sequence[F64]) -> float:
    """Of a polyline of points (2,) m."""
    return float(np.linalg.norm(np.diff(np.array(points), axis=0), axis=1).sum())
