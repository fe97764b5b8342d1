"""Vehicle routes: pose as a smooth function of time, four times differentiable, so that an IMU can be derived from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from wayloom.simulation.city.streets import F64
from wayloom.simulation.city.terrain import Terrain

SPLINE_DEGREE = 5
KNOT_M = 1.0
"""Distance of the points through which a route's line is laid."""
SIDEWAYS_M_S2 = 2.6
"""Sideways acceleration up to which a driver takes a corner."""
ROLL_RAD, PITCH_RAD, HEAVE_M = 0.005, 0.006, 0.010
"""Amplitudes of the body's sway on an uneven road."""
PULL_M_S2, BRAKE_M_S2 = 1.6, 1.8
LAP_UNIT_S, LAP_EASE_M, TIME_STEP_S = 0.1, 10.0, 0.2
EASE_STEPS = 5
MARGIN_S = 0.6
"""How long a motion goes on before its start and after its end, so that it has derivatives there."""
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


def line_through(s_m: F64, xy: F64, around_m: float | None = None) -> Line:
    """The line through a polyline of places xy (N, 2) at s (N,), taken every KNOT_M or so; with around_m its first part, closed."""
    length = float(s_m[-1]) if around_m is None else around_m
    count = max(SPLINE_DEGREE + 2, round(length / KNOT_M) + 1)
    s = np.linspace(0.0, length, count)
    return smooth_line(s, np.column_stack([np.interp(s, s_m, xy[:, k]) for k in (0, 1)]), around_m is not None)


@dataclass(frozen=True, slots=True)
class Route:
    """A drive from start_s to end_s (s since the city's time zero), or, with lap_s, around and around.

    line        the path over the ground
    arc_length  along the line (m) as a spline of time; within one lap where there are laps
    ground      the terrain below
    """

    line: Line
    arc_length: BSpline
    ground: Terrain
    start_s: float
    end_s: float
    lap_s: float | None = None

    @property
    def duration_s(self) -> float:
        """Duration of the drive, or of one lap, s."""
        return self.end_s - self.start_s

    @property
    def length_m(self) -> float:
        """Driven from start to end, or in one lap."""
        return float(self.arc_length(self.end_s) - self.arc_length(self.start_s))

    def travelled(self, t_s: ArrayLike, derivative: int = 0) -> F64:
        """(M,) arc length at times t_s (M,), m, or its derivative by time (1 speed, 2 longitudinal acceleration).

        Motion goes on for MARGIN_S before the start and after the end; beyond, the vehicle stands, unless it goes in laps.
        """
        t = np.atleast_1d(np.asarray(t_s, float))
        if self.lap_s is None:
            inside = np.clip(t, self.start_s - MARGIN_S, self.end_s + MARGIN_S)
            return np.asarray(self.arc_length(inside, derivative) * ((t == inside) | (derivative == 0)))
        laps = np.floor((t - self.start_s) / self.lap_s)
        arc_length = self.arc_length(t - laps * self.lap_s, derivative)
        return np.asarray(arc_length + laps * self.line.length_m if derivative == 0 else arc_length)

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


def timed(t_s: F64, arc_m: F64) -> BSpline:
    """The arc length along a line (N,) m at times t_s (N,) as a spline of time; four times continuously differentiable."""
    return make_interp_spline(t_s, arc_m, k=SPLINE_DEGREE)


def fastest_along(line: Line, s_m: F64, fastest_m_s: float) -> F64:
    """(M,) m/s: comfortable speed at each place of a line, limited by lateral acceleration."""
    return np.asarray(np.minimum(fastest_m_s, np.sqrt(SIDEWAYS_M_S2 / np.maximum(np.abs(line.curvature(s_m)), 1e-6))))


def lap_route(line: Line, ground: Terrain, start_m: float, start_s: float, fastest_m_s: float) -> Route:
    """Around a closed line without an end: as fast as bends allow, each lap like the others, in a whole number of LAP_UNIT_S."""
    count = 2 * round(line.length_m)
    s = np.linspace(0.0, line.length_m, count, endpoint=False)
    ds = line.length_m / count
    thrice = _reachable(ds, np.tile(fastest_along(line, s, fastest_m_s), 3))[count : 2 * count]
    window = np.hanning(2 * round(LAP_EASE_M / ds) + 3)[1:-1]
    pad = len(window) // 2
    speed = np.convolve(np.concatenate([thrice[-pad:], thrice, thrice[:pad]]), window / window.sum(), "valid")
    after = np.concatenate([[0.0], np.cumsum(ds * 2 / (speed + np.roll(speed, -1)))])
    lap = float(np.ceil(after[-1] / LAP_UNIT_S) * LAP_UNIT_S)
    times, places = after * (lap / after[-1]), np.append(s, line.length_m)
    beyond = 40 * TIME_STEP_S  # the spline's ends no longer matter within
    t = np.linspace(-beyond, lap + beyond, round((lap + 2 * beyond) / TIME_STEP_S) + 1)
    three_times = np.concatenate([times[:-1] - lap, times[:-1], times + lap])
    three_places = np.concatenate([places[:-1] - line.length_m, places[:-1], places + line.length_m])
    begin = float(np.interp(start_m, three_places, three_times))
    arc_length = np.interp(t + begin, three_times, three_places)
    return Route(line, timed(t + start_s, arc_length), ground, start_s, start_s + lap, lap)


def eased(arc_m: F64) -> F64:
    """Arc length at even time steps, smoothed over 2 EASE_STEPS + 1 of them, so that acceleration is continuous."""
    window = np.hanning(2 * EASE_STEPS + 3)[1:-1]
    before = arc_m[0] + (arc_m[1] - arc_m[0]) * np.arange(-EASE_STEPS, 0)
    after = arc_m[-1] + (arc_m[-1] - arc_m[-2]) * np.arange(1, EASE_STEPS + 1)
    return np.asarray(np.convolve(np.concatenate([before, arc_m, after]), window / window.sum(), "valid"))


def _reachable(ds_m: float, limit: F64) -> F64:
    """The limit (N,) m/s at places ds_m apart lowered to what bounded acceleration allows: v^2 changes by at most 2 a ds."""
    v2 = limit**2
    for k in range(len(v2) - 1):
        v2[k + 1] = min(v2[k + 1], v2[k] + 2 * PULL_M_S2 * ds_m)
    for k in range(len(v2) - 2, -1, -1):
        v2[k] = min(v2[k], v2[k + 1] + 2 * BRAKE_M_S2 * ds_m)
    return np.asarray(np.sqrt(v2))
