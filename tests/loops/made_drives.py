"""Made drives through a made street, there and back, for the search for loops."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from registration.made_streets import CAMERA_M, Street, surface_points, visible
from wayloom.files.growing_arrays import GrowingTable
from wayloom.geometry import se3
from wayloom.places.cloud import no_cloud, packed
from wayloom.places.types import PlaceFeatures, Places, PlaceStations

FloatArray = NDArray[np.float64]
STEP_M = 2.0
POINTS = 110
"""Of each keyframe."""


def there(start_m: float, end_m: float) -> FloatArray:
    """(K, 4, 4) T_street_cam along the street, forwards."""
    return cameras(np.arange(start_m, end_m, STEP_M), 1.8, 1.0)


def there_and_back(start_m: float, end_m: float) -> FloatArray:
    """(K, 4, 4) T_street_cam along the street, and on the other lane back."""
    return np.concatenate([there(start_m, end_m), cameras(np.arange(end_m, start_m, -STEP_M), -1.8, -1.0)])


def cameras(y_m: FloatArray, x_m: float, heading: float) -> FloatArray:
    """(K, 4, 4) T_street_cam of cameras that look along the street."""
    T = np.tile(np.eye(4), (len(y_m), 1, 1))
    T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = [heading, 0, 0], [0, 0, -1], [0, heading, 0]
    T[:, :3, 3] = np.column_stack([np.full(len(y_m), x_m), y_m, np.full(len(y_m), CAMERA_M)])
    return T


def made_places(street: Street, T_street_cam: FloatArray, seed: int, drift_share: float = 0.002) -> Places:
    """What is kept of a drive along these cameras (K, 4, 4), whose odometry turns and stretches a little at each step."""
    rng = np.random.default_rng(seed)
    cloud = GrowingTable(no_cloud())
    for k, T in enumerate(T_street_cam):
        cloud.append(_cloud(street, T, k, rng))
    return Places(
        drifted(T_street_cam, drift_share, rng), np.zeros(len(T_street_cam), np.int32), (400.0, 400.0, 320.0, 120.0, 640, 240),
        no_features(), cloud.table(),
    )  # fmt: skip


def drifted(T_street_cam: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """(K, 4, 4) T_world_cam, world the first camera: steps with a constant error of scale and white ones of heading."""
    T = [np.eye(4)]
    for one, other in pairwise(T_street_cam):
        step = se3.inverse(one) @ other
        step[:3, 3] *= 1.0 + share
        T.append(T[-1] @ step @ se3.exp(np.concatenate([np.zeros(3), rng.normal(0, 2e-4, 3)])))
    return np.array(T)


def _cloud(street: Street, T_street_cam: FloatArray, k: int, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    points, label = surface_points(street, float(T_street_cam[1, 3]), rng, 12 * POINTS)
    p_cam = se3.transform(se3.inverse(T_street_cam), points)
    z = p_cam[:, 2]
    seen = (z > 4.0) & (z < 32.0) & (np.abs(p_cam[:, 0]) < z) & (np.abs(p_cam[:, 1]) < 0.5 * z)
    rows = np.flatnonzero(seen)
    rows = rows[visible(street, np.tile(T_street_cam[:3, 3], (len(rows), 1)), points[rows])][:POINTS]
    sigma = 0.02 + 0.0007 * z[rows] ** 2
    noisy = p_cam[rows] * (1.0 + sigma * rng.normal(size=len(rows)) / z[rows])[:, None] + rng.normal(0, 0.02, (len(rows), 3))
    return packed(np.full(len(rows), k, np.int32), noisy, label[rows], sigma)


def no_features() -> PlaceFeatures:
    """None at all."""
    none = np.zeros((0, 3), np.float32)
    return PlaceFeatures(np.zeros(0, np.int32), np.zeros((0, 32), np.uint8), none[:, :2], none, none[:, 0])


def with_features(places: Places, T_street_cam: FloatArray, seed: int) -> Places:
    """The places with stations and local features: corners of both walls that look alike from all cameras but for a few bits."""
    rng = np.random.default_rng(seed)
    start, end = T_street_cam[:, 1, 3].min(), T_street_cam[:, 1, 3].max() + 30.0
    count = int(8 * (end - start))
    corners = np.column_stack(
        [rng.choice([-7.0, 7.0], count) + rng.normal(0, 0.8, count), rng.uniform(start, end, count), rng.uniform(0, 6, count)]
    )
    bits = rng.integers(0, 256, (count, 32)).astype(np.uint8)
    seen = [_features(corners, bits, T, k, rng) for k, T in enumerate(T_street_cam)]
    columns = [np.concatenate([getattr(f, name) for f in seen]) for name in ("keyframe", "bits", "uv", "p_cam", "sigma_m")]
    stations = np.arange(0, len(T_street_cam), 5, dtype=np.int32)
    grids = PlaceStations(stations, np.zeros((len(stations), 3, 32, 24), np.uint8))
    return replace(places, features=PlaceFeatures(*columns), stations=grids)


def _features(corners: FloatArray, bits: NDArray[np.uint8], T_street_cam: FloatArray, k: int, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    p = se3.transform(se3.inverse(T_street_cam), corners)
    z = p[:, 2]
    rows = np.flatnonzero((z > 4.0) & (z < 30.0) & (np.abs(p[:, 0]) < 0.8 * z) & (np.abs(p[:, 1]) < 0.3 * z))
    sigma = 0.02 + 0.0015 * z[rows] ** 2
    noisy = p[rows] * (1.0 + sigma * rng.normal(size=len(rows)) / z[rows])[:, None]
    uv = 400.0 * p[rows, :2] / z[rows, None] + [320.0, 120.0] + rng.normal(0, 0.3, (len(rows), 2))
    noisy[:, :2] = (uv - [320.0, 120.0]) / 400.0 * noisy[:, 2:]
    flipped = np.packbits(rng.random((len(rows), 256)) < 0.03, axis=1)
    return PlaceFeatures(
        np.full(len(rows), k, np.int32), bits[rows] ^ flipped, uv.astype(np.float32), noisy.astype(np.float32),
        sigma.astype(np.float32),
    )  # fmt: skip
