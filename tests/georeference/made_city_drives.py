"""Made city drives with exact truth: a way that comes back to some of its streets, odometry that drifts, closures and GNSS."""

import numpy as np
from numpy.typing import NDArray

from georeference.made_gnss_drives import LEVER, PLACE, MadeDrive, MadeLog, drifting, odometry_of
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.georeference.nodes import travelled
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.types import FixType, GnssTrack
from wayloom.loops.types import LoopClosures, no_loops
from wayloom.simulation.sensors.gnss import SIGMA_M, fix_errors

FloatArray = NDArray[np.float64]
CITY_WAY = [(0, 0), (0, 600), (500, 600), (500, 0), (0, 0), (0, 300), (-800, 300), (-800, 800), (0, 800), (0, 50)]
"""Corners of a way of 5.3 km, m east and north: it drives 300 m of its first street again, and comes home along 550 m of it in the
other direction."""
SMALL_WAY = [(0, 0), (0, 150), (120, 150), (120, 0), (0, 0), (0, 120)]
STEP_M, FRAME_S, RADIUS_M = 1.0, 0.1, 8.0
CLOSURE_SIGMA_M, CLOSURE_SIGMA_RAD = 0.05, np.radians(0.1)


def city_path(corners: list[tuple[float, float]]) -> FloatArray:
    """(N, 4, 4) T_place_cam, a frame a metre: straight streets, round corners, hills of a few metres."""
    track = _rounded(np.array(corners, float))
    road = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    at = np.arange(0.0, road[-1], STEP_M)
    xy = np.stack([np.interp(at, road, axis) for axis in track.T], axis=1)
    place = np.column_stack([xy, 2.0 * np.sin(xy[:, 0] / 90.0) + 3.0 * np.cos(xy[:, 1] / 130.0)])
    forward = np.gradient(place, axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return se3.from_rotation_translation(np.stack([right, np.cross(forward, right), forward], axis=2), place)


def _rounded(corners: FloatArray) -> FloatArray:
    """The polyline with arcs of RADIUS_M at its corners, a point every quarter metre or so."""
    points = [corners[:1]]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        into, out = (corner - before) / np.linalg.norm(corner - before), (after - corner) / np.linalg.norm(after - corner)
        if abs(into @ out) > 0.999:
            continue
        angle = np.linspace(0.0, np.pi / 2.0, 50)[:, None]
        centre = corner - RADIUS_M * into + RADIUS_M * out
        points.append(centre - RADIUS_M * out * np.cos(angle) + RADIUS_M * into * np.sin(angle))
    return np.concatenate([*points, corners[-1:]])


def city_drive(corners: list[tuple[float, float]] = CITY_WAY, seed: int = 0, scale_sigma: float = 0.02) -> MadeDrive:
    """Odometry with the errors that were measured (docs/decisions/0008), its scale as on real streets; no GNSS yet."""
    T = city_path(corners)
    t_ns = 1_000_000_000 + np.arange(len(T), dtype=np.int64) * int(1e9 * FRAME_S)
    odometry = odometry_of(t_ns, drifting(T, np.random.default_rng(seed), scale_sigma=scale_sigma))
    return MadeDrive(MadeLog(None, LEVER), odometry, T)


def antennas(drive: MadeDrive) -> FloatArray:
    """(N, 3) m: where the antenna truly is at each frame."""
    return drive.T_place_cam[:, :3, :3] @ LEVER + drive.T_place_cam[:, :3, 3]


def gnss_of(drive: MadeDrive, kind: FixType, seed: int, every: int = 2) -> GnssTrack:
    """A fix every so many frames with the simulator's noise: half of its variance is white, half correlated over 8 s."""
    t_ns = drive.odometry.trajectory.t_ns[::every]
    kinds = np.full(len(t_ns), kind, np.uint8)
    errors = fix_errors(kinds, every * FRAME_S, np.random.default_rng(seed))
    places = wgs84.lonlatheight_from_enu(antennas(drive)[::every] + errors, PLACE)
    variance = (SIGMA_M[kind] * np.array([1.0, 1.0, UP_FACTOR])) ** 2
    return GnssTrack(t_ns, places, np.tile(np.diag(variance), (len(t_ns), 1, 1)), kinds)


def with_outages(gnss: GnssTrack, starts_s: list[float], length_s: float = 30.0) -> tuple[GnssTrack, NDArray[np.bool_]]:
    """Without fixes for so long from each start on; and which fixes (M,) those were."""
    t_s = 1e-9 * (gnss.t_ns - gnss.t_ns[0])
    gone = np.any([(t_s >= start) & (t_s < start + length_s) for start in starts_s], axis=0)
    kinds = np.where(gone, FixType.NONE, gnss.fix_type).astype(np.uint8)
    return GnssTrack(gnss.t_ns, gnss.lon_lat_height, gnss.covariance_enu, kinds), gone


def with_bursts(gnss: GnssTrack, bursts: list[tuple[float, float, list[float]]]) -> GnssTrack:
    """Moved by (3,) m from a start for so many seconds, each burst."""
    t_s, enu = 1e-9 * (gnss.t_ns - gnss.t_ns[0]), wgs84.enu_from_lonlatheight(gnss.lon_lat_height, PLACE)
    for start, length, by in bursts:
        enu[(t_s >= start) & (t_s < start + length)] += by
    return GnssTrack(gnss.t_ns, wgs84.lonlatheight_from_enu(enu, PLACE), gnss.covariance_enu, gnss.fix_type)


def closures_of(drive: MadeDrive, seed: int = 0, apart_m: float = 4.0, every_m: float = 10.0, false: int = 0) -> LoopClosures:
    """Where the way comes back to within apart_m after 100 m or more: a closure every so many metres between the nearest keyframes,
    as its covariance says; then so many false ones, between places that have nothing in common, in rows of three."""
    keyframes, rng = drive.odometry.keyframes, np.random.default_rng(seed)
    T = drive.T_place_cam[keyframes.frame]
    road = travelled(drive.odometry.trajectory)[keyframes.frame]
    pairs, last = [], -np.inf
    for b in range(len(T)):
        if road[b] - last < every_m:
            continue
        earlier = np.flatnonzero(road < road[b] - 100.0)
        distance = np.linalg.norm(T[earlier, :3, 3] - T[b, :3, 3], axis=1)
        if len(earlier) and distance.min() < apart_m and abs(T[earlier[np.argmin(distance)], :3, 2] @ T[b, :3, 2]) > 0.9:
            pairs.append((int(earlier[np.argmin(distance)]), b))
            last = road[b]
    if not pairs and not false:
        return no_loops()
    T_a_b = [se3.inverse(T[a]) @ T[b] for a, b in pairs]
    for _ in range(false // 3):
        a, b = sorted(rng.choice(len(T) - 10, 2, replace=False).tolist())
        nonsense = se3.exp(np.concatenate([3.0 * rng.normal(size=3), 0.05 * rng.normal(size=3)]))
        for k in range(3):
            pairs.append((a + 3 * k, b + 3 * k))
            T_a_b.append(se3.inverse(T[a + 3 * k]) @ T[a] @ nonsense @ se3.inverse(T[b]) @ T[b + 3 * k])
    sigma = np.repeat([CLOSURE_SIGMA_M, CLOSURE_SIGMA_RAD], 3)
    noisy = se3.exp(np.random.default_rng(1000 + seed).normal(size=(len(pairs), 6)) * sigma) @ np.array(T_a_b)
    first, second = np.array(pairs, np.int32).T
    return LoopClosures(first, second, noisy, np.tile(np.diag(sigma**2), (len(pairs), 1, 1)))


def start_at(T_from_cam: FloatArray, first: int = 0) -> FloatArray:
    """The poses seen from a level frame at the first one, which looks north there."""
    T = T_from_cam[first]
    ahead = np.array([T[0, 2], T[1, 2], 0.0]) / np.hypot(T[0, 2], T[1, 2])
    R_enu_own = np.stack([np.cross(ahead, [0.0, 0.0, 1.0]), ahead, [0.0, 0.0, 1.0]], axis=1)
    return se3.inverse(se3.from_rotation_translation(R_enu_own, T[:3, 3])) @ T_from_cam
