"""Clipping of what is kept along a submap: points, ground cells, sightings, places and looks inside of areas are dropped."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import Looks
from wayloom.exclusion.areas import Area
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.ground.sheet import CELL_M, LARGEST_SIGMA_MM, NO_HEIGHT, GroundSheet
from wayloom.objects.types import CELL_M as LOOKED_CELL_M
from wayloom.objects.types import COLUMNS, ObjectSightings
from wayloom.places.types import PlaceCloud, PlaceFeatures, Places, PlaceStations
from wayloom.submaps.submap import Submap

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Inside = Callable[[FloatArray], BoolArray]
"""Of points (N, 3), m, in a submap's frame: (N,) whether they lie in an excluded area."""


def inside_of(areas: Sequence[Area], T_enu_submap: FloatArray, frame: MapFrame, margin_m: float) -> Inside:
    """For a submap at T_enu_submap (4, 4) in the frame, whose place is uncertain by the margin."""

    def inside(points_submap: FloatArray) -> BoolArray:
        found = np.zeros(len(points_submap), bool)
        if len(points_submap):
            places = wgs84.lonlatheight_from_enu(se3.transform(T_enu_submap, points_submap), frame)[:, :2]
            for area in areas:
                found |= area.contains(places, margin_m)
        return found

    return inside


def clipped_submap(submap: Submap, inside: Inside) -> Submap:
    """Without the points inside; the same object where there is none."""
    dropped = inside(submap.xyz.astype(np.float64))
    if not dropped.any():
        return submap
    rows = np.flatnonzero(~dropped)
    start = submap.vote_start.astype(np.int64)
    votes = np.repeat(~dropped, np.diff(start))
    of_points = ("xyz", "label", "variance", "grey", "seen_ns", "keyframe")
    return replace(
        submap,
        **{name: getattr(submap, name)[rows] for name in of_points},
        vote_start=np.concatenate([[0], np.cumsum(np.diff(start)[rows])]).astype(np.uint32),
        vote_class=submap.vote_class[votes],
        vote_weight=submap.vote_weight[votes],
        points_left_out={**submap.points_left_out, "excluded": submap.points_left_out.get("excluded", 0) + int(dropped.sum())},
    )


def clipped_sheet(sheet: GroundSheet, inside: Inside, submap: str) -> GroundSheet:
    """Without the cells inside, as the sheet of a submap of this digest."""
    rows, columns = sheet.height_mm.shape
    x, y = np.meshgrid(CELL_M * (sheet.corner[0] + np.arange(columns) + 0.5), CELL_M * (sheet.corner[1] + np.arange(rows) + 0.5))
    points = np.column_stack([x.ravel(), y.ravel(), np.nan_to_num(sheet.height).ravel()])
    dropped = inside(se3.transform(sheet.T_submap_sheet, points)).reshape(rows, columns)
    pixels = np.repeat(np.repeat(dropped, 2, axis=0), 2, axis=1)
    return replace(
        sheet,
        submap=submap,
        height_mm=np.where(dropped, NO_HEIGHT, sheet.height_mm).astype(np.int16),
        sigma_mm=np.where(dropped, LARGEST_SIGMA_MM, sheet.sigma_mm).astype(np.uint8),
        votes=np.where(dropped[:, :, None], 0, sheet.votes).astype(np.uint16),
        colour=np.where(pixels[:, :, None], 0, sheet.colour).astype(np.uint8),
        sharpness=np.where(pixels, 0, sheet.sharpness).astype(np.uint8),
    )


def clipped_sightings(found: ObjectSightings, inside: Inside, submap: str) -> ObjectSightings:
    """Without the things inside, and without where the drive looked there, as those along a submap of this digest."""
    kept = ~inside(found.position.astype(np.float64))
    rows, columns = found.looked.shape
    x, y = np.meshgrid(
        LOOKED_CELL_M * (found.corner[0] + np.arange(columns) + 0.5), LOOKED_CELL_M * (found.corner[1] + np.arange(rows) + 0.5)
    )
    cells = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    dropped = inside(se3.transform(found.T_submap_level, cells)).reshape(rows, columns)
    looked = np.where(dropped, 0, found.looked).astype(np.uint8)
    return replace(found, submap=submap, looked=looked, **{name: getattr(found, name)[kept] for name in COLUMNS})


def clipped_looks(looks: Looks, frames: NDArray[np.int64]) -> Looks:
    """Without those taken at these frames (n,) of the drive."""
    return looks.take(np.flatnonzero(~np.isin(looks.frame, frames)))


def clipped_places(places: Places, keyframes: BoolArray, features: BoolArray, cloud: BoolArray) -> Places:
    """Without the features (F,) and points (P,) inside, and without what keyframes (K,) inside have seen. The keyframes stay, since
    others count them."""
    f, c, s = places.features, places.cloud, places.stations
    of_features, of_cloud = ~(features | keyframes[f.keyframe]), ~(cloud | keyframes[c.keyframe])
    of_stations = ~keyframes[s.keyframe]
    return replace(
        places,
        features=PlaceFeatures(
            f.keyframe[of_features], f.bits[of_features], f.uv[of_features], f.p_cam[of_features], f.sigma_m[of_features]
        ),
        cloud=PlaceCloud(c.keyframe[of_cloud], c.p_cam[of_cloud], c.label[of_cloud], c.sigma_cm[of_cloud]),
        stations=PlaceStations(s.keyframe[of_stations], s.grid[of_stations]),
    )
