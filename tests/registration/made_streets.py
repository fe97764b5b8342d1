"""Made streets for the registration's tests: buildings, poles and trees as boxes, and the views of cameras that drive there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.places.types import PlaceFeatures, PlaceView

FloatArray = NDArray[np.float64]
CAMERA_M = 1.65
BLOCK_M = 60.0
ROAD = CLASS_ID["road"]


@dataclass(frozen=True)
class Street:
    """Boxes along a street whose axis is y, x to the right, z up from the ground: low, high (B, 3) m, label (B,)."""

    low: FloatArray
    high: FloatArray
    label: NDArray[np.uint8]


def made_street(seed: int, blocks: int = 4, alike: bool = False) -> Street:
    """A street of blocks with crossings between them; all blocks the same where they are `alike`."""
    boxes: list[tuple[list[float], list[float], str]] = []
    for block in range(blocks):
        rng = np.random.default_rng([seed, 0 if alike else block])
        for side in (-1.0, 1.0):
            boxes += _buildings(rng, side, block * BLOCK_M)
            boxes += _furniture(rng, side, block * BLOCK_M)
    low, high = (np.array([box[k] for box in boxes]) for k in (0, 1))
    return Street(low, high, np.array([CLASS_ID[box[2]] for box in boxes], np.uint8))


def _box(side: float, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], name: str):  # type: ignore[no-untyped-def]
    near, far = sorted((side * x[0], side * x[1]))
    return [near, y[0], z[0]], [far, y[1], z[1]], name


def _buildings(rng: np.random.Generator, side: float, start: float):  # type: ignore[no-untyped-def]
    out, y = [], start
    while y < start + BLOCK_M - 14:
        width, setback, height = rng.uniform(6, 14), rng.uniform(6.5, 9.5), rng.uniform(5, 14)
        out.append(_box(side, (setback, setback + 8), (y, min(y + width, start + BLOCK_M - 12)), (0, height), "building"))
        y += width + (rng.uniform(1, 4) if rng.random() < 0.4 else 0.0)
    return out


def _furniture(rng: np.random.Generator, side: float, start: float):  # type: ignore[no-untyped-def]
    out = []
    for y in start + rng.uniform(0, BLOCK_M, 3):
        out.append(_box(side, (4.6, 4.75), (y, y + 0.15), (0, 5.0), "pole"))
    for y in start + rng.uniform(0, BLOCK_M, 2):
        out.append(_box(side, (4.4, 6.2), (y, y + 1.8), (2.2, 5.0), "vegetation"))
    return out


def view_of(street: Street, y_m: float, seed: int, forward: bool = True, count: int = 3000) -> tuple[PlaceView, FloatArray]:
    """The view of a camera at y_m that drives along the street or back, and T_street_level (4, 4)."""
    rng = np.random.default_rng(seed)
    lane = 1.8 if forward else -1.8
    heading = 1.0 if forward else -1.0
    along = np.arange(-30.0, 30.1, 2.0)
    cameras = np.column_stack([np.full(len(along), lane), y_m + along, np.full(len(along), CAMERA_M)])
    points, label = surface_points(street, y_m, rng, 12 * count)
    camera = rng.integers(0, len(cameras), len(points))
    ray = points - cameras[camera]
    depth = heading * ray[:, 1]
    seen = (depth > 4.0) & (depth < 32.0) & (np.abs(ray[:, 0]) < depth) & (np.abs(ray[:, 2]) < 0.5 * depth)
    rows = np.flatnonzero(seen)
    rows = rows[visible(street, cameras[camera[rows]], points[rows])][:count]
    sigma = 0.02 + 0.0007 * depth[rows] ** 2
    direction = ray[rows] / np.linalg.norm(ray[rows], axis=1)[:, None]
    noisy = points[rows] + direction * (sigma * rng.normal(size=len(rows)))[:, None] + rng.normal(0, 0.02, (len(rows), 3))
    tilt = se3.exp(np.concatenate([np.zeros(3), rng.normal(0, np.deg2rad(0.4), 2), [0.0]]))
    T_street_level = np.eye(4)
    T_street_level[:3, :3] = np.diag([heading, heading, 1.0])
    T_street_level[:3, 3] = lane, y_m, CAMERA_M
    T_street_level = T_street_level @ tilt
    T_level_street = se3.inverse(T_street_level)
    view = PlaceView(
        0, np.eye(4), se3.transform(T_level_street, noisy).astype(np.float32), label[rows], sigma.astype(np.float32),
        camera[rows].astype(np.int32), se3.transform(T_level_street, cameras), no_features(), np.zeros((0, 4, 4)),
    )  # fmt: skip
    return view, T_street_level


def no_features() -> PlaceFeatures:
    """None at all, as where a street is driven the other way."""
    none = np.zeros((0, 3), np.float32)
    return PlaceFeatures(np.zeros(0, np.int32), np.zeros((0, 32), np.uint8), none[:, :2], none, none[:, 0])


def surface_points(street: Street, y_m: float, rng: np.random.Generator, count: int) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Points on the boxes' walls and on the ground, within 70 m along the street."""
    near = np.flatnonzero((street.high[:, 1] > y_m - 70) & (street.low[:, 1] < y_m + 70))
    size = (street.high - street.low)[near]
    weight = np.sqrt((size[:, 0] + size[:, 1]) * size[:, 2])  # of thin things more than their area
    box = near[rng.choice(len(near), count, p=weight / weight.sum())]
    points = rng.uniform(street.low[box], street.high[box])
    axis, end = rng.integers(0, 2, count), rng.random(count) < 0.5
    rows = np.arange(count)
    points[rows, axis] = np.where(end, street.low[box, axis], street.high[box, axis])
    ground = rng.random(count) < 0.1
    points[ground] = np.column_stack([rng.uniform(-6, 6, count), rng.uniform(y_m - 60, y_m + 60, count), np.zeros(count)])[ground]
    return points, np.where(ground, np.uint8(ROAD), street.label[box])


def visible(street: Street, cameras: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether no box stands between cameras (N, 3) and points (N, 3), by slabs."""
    ray = points - cameras
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (np.stack([street.low, street.high])[:, None] - cameras[None, :, None]) / ray[None, :, None]
    enter, leave = np.nanmax(t.min(axis=0), axis=2), np.nanmin(t.max(axis=0), axis=2)
    hidden: NDArray[np.bool_] = ((enter < leave) & (leave > 0) & (enter < 0.999)).any(axis=1)
    return ~hidden
