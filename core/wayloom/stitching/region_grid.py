"""Grid of regions: squares of the map's frame, where they lie on Earth, and the layers of one of them."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.change_types import Change
from wayloom.stitching.settings import HALO_M
from wayloom.stitching.voxel_map import VoxelMap

FloatArray = NDArray[np.float64]
LonLatBox = tuple[float, float, float, float]
"""West, south, east, north in degrees; across the antimeridian east is over 180 (`geodesy.antimeridian.box_of`)."""
RegionKey = tuple[int, int]
"""Column from the west, row from the south."""
REGION_M: Final = 64.0
EARTH_M: Final = 6_371_000.0
STEEP_M: Final = 1000.0
"""Heights above and below the ellipsoid of the frame's origin between which the map lies."""


@dataclass(frozen=True, slots=True)
class RegionMap:
    """The layers of one region by their names in LAYERS, and what has gone from it and is new."""

    key: RegionKey
    layers: dict[str, VoxelMap]
    changes: tuple[Change, ...] = ()


def region_edges(key: RegionKey, edge_m: float = REGION_M) -> tuple[FloatArray, FloatArray]:
    """South-western and north-eastern corner (2,), m east and north in the map's frame."""
    return edge_m * np.array(key, np.float64), edge_m * (np.array(key, np.float64) + 1.0)


def regions_within(low_enu: FloatArray, high_enu: FloatArray, around_m: float = HALO_M) -> Iterable[RegionKey]:
    """The regions that points of a box (2,) to (2,), m east and north, may bear on; with `around_m` 0 those that it touches."""
    first = np.floor((low_enu - around_m) / REGION_M).astype(int).tolist()
    last = np.floor((high_enu + around_m) / REGION_M).astype(int).tolist()
    return itertools.product(range(first[0], last[0] + 1), range(first[1], last[1] + 1))


def regions_of_box(box: LonLatBox, frame: MapFrame, around_m: float = HALO_M) -> Iterator[RegionKey]:
    """The regions that what lies in a box of degrees may change, and perhaps some beside them."""
    low, high = enu_box(box, frame)
    yield from regions_within(low, high, around_m)


def region_box(key: RegionKey, frame: MapFrame, around_m: float) -> LonLatBox:
    """Degrees around a region and so much more, whatever the height; across the antimeridian east is over 180."""
    low, high = region_edges(key)
    corners = _corners(low - around_m, high + around_m, (-STEEP_M, STEEP_M))
    corners[:, 2] -= (corners[:, :2] ** 2).sum(axis=1) / (2.0 * EARTH_M)  # the plane leaves the Earth
    return box_of(wgs84.lonlatheight_from_enu(corners, frame)[:, :2])


def enu_box(box: LonLatBox, frame: MapFrame) -> tuple[FloatArray, FloatArray]:
    """Two corners (2,), m east and north, around a box of degrees, whatever the height."""
    west, south, east, north = box
    edge = _corners(np.array([west, south]), np.array([east, north]), (frame.height_m - STEEP_M, frame.height_m + STEEP_M))
    edge[:, 0] = np.where(edge[:, 0] > 180.0, edge[:, 0] - 360.0, edge[:, 0])
    places = wgs84.enu_from_lonlatheight(edge, frame)[:, :2]
    return places.min(axis=0), places.max(axis=0)


def _corners(low: FloatArray, high: FloatArray, heights: tuple[float, float]) -> FloatArray:
    """(18, 3): a grid over a box at two heights. Edges of some hundred metres bend by far less than the halo."""
    grid = np.array([[x, y, h] for h in heights for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)])
    grid[:, :2] = low + grid[:, :2] * (high - low)
    return grid
