"""Insets of the overview picture: places worth a closer look, and how they are drawn: orthophoto under labelled points."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, PALETTE_WITH_VOID
from wayloom.exports.city_survey import SeenRegion, Survey
from wayloom.exports.source import MapSource
from wayloom.geometry import se3
from wayloom.ground.sheet import PIXEL_M
from wayloom.stitching.ground_mosaic import mosaic
from wayloom.stitching.region_grid import regions_within

FloatArray = NDArray[np.float64]
Picture = NDArray[np.float32]
MOST_INSETS: Final = 4
EDGE_M: Final = 48.0
APART: Final = 1.2
"""Least distance of two insets, in their edges."""
NEAR_TRACK_M: Final = 60.0
PIXELS: Final = 1000
DOT_M: Final = 0.22
GROUND: Final = tuple(CLASS_ID[name] for name in ("road", "sidewalk", "terrain"))
GROUND_ALPHA: Final = 0.5
BARE: Final = 0.965
"""Grey of what no camera saw."""


@dataclass(frozen=True, slots=True)
class Inset:
    """A place: middle (2,) m in the survey's plane, and its shorter edge."""

    middle: FloatArray
    edge_m: float


def chosen_insets(survey: Survey) -> list[Inset]:
    """The places with the most points of the most classes, on roads, apart from each other: first one for each part of the map."""
    span = float((survey.high - survey.low).max())
    found: list[Inset] = []
    for apart_m in (max(0.2 * span, APART * EDGE_M), APART * EDGE_M):
        for region in sorted(survey.regions, key=_worth):
            middle = _on_road(survey, region)
            if len(found) < MOST_INSETS and all(np.linalg.norm(middle - one.middle) >= apart_m for one in found):
                found.append(Inset(middle, EDGE_M))
    return sorted(found, key=lambda one: -float(one.middle[1]))


def _worth(region: SeenRegion) -> tuple[int, tuple[int, int]]:
    """Orders the best first, equals by their place."""
    return -region.points * (1 + region.classes), region.key


def _on_road(survey: Survey, region: SeenRegion) -> FloatArray:
    """The place of a track nearest to the middle of the region's points; the middle where none is near."""
    places = [track.points[:, :2] for track in survey.tracks]
    if not places:
        return region.middle
    on_tracks = np.concatenate(places)
    away = np.linalg.norm(on_tracks - region.middle, axis=1)
    nearest = int(np.argmin(away))
    return on_tracks[nearest] if away[nearest] < NEAR_TRACK_M else region.middle


def drawn_inset(source: MapSource, survey: Survey, middle: FloatArray, edges: FloatArray) -> Picture:
    """(h, w, 3) RGB, 0 to 1, rows from the south: a window of the survey's plane, its middle and edges (2,) in m."""
    pixel_m = float(edges.max()) / PIXELS
    width, height = np.rint(edges / pixel_m).astype(int).tolist()
    low = middle - 0.5 * edges
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    T_frame_plane = se3.inverse(survey.T_plane_frame)
    level = float(se3.transform(survey.T_plane_frame, source.place[None])[0, 2])
    plane = np.column_stack([low[0] + column.ravel() * pixel_m, low[1] + row.ravel() * pixel_m, np.full(column.size, level)])
    places = se3.transform(T_frame_plane, plane)[:, :2].reshape(height, width, 2)
    keys = [*regions_within(places.min(axis=(0, 1)), places.max(axis=(0, 1)), 0.0)]
    picture = _photo(source, keys, places)
    points, label = _points(source, keys, survey.T_plane_frame)
    _paint(picture, points, label, low, pixel_m)
    return picture


def _photo(source: MapSource, keys: list[tuple[int, int]], places: FloatArray) -> Picture:
    """The orthophoto at places (h, w, 2) of the frame; a light grey where there is none."""
    picture = np.full((*places.shape[:2], 3), BARE, np.float32)
    known = [key for key in keys if source.raster(key, "colour") is not None]
    if known:
        first = np.floor(places.min(axis=(0, 1)) / PIXEL_M).astype(np.int64)
        last = np.ceil(places.max(axis=(0, 1)) / PIXEL_M).astype(np.int64) + 1
        colour, sharpness = (mosaic(known, source, name, first, last, PIXEL_M) for name in ("colour", "sharpness"))
        at = np.floor(places / PIXEL_M).astype(np.int64) - first
        shown, seen = colour[at[..., 1], at[..., 0]], sharpness[at[..., 1], at[..., 0]] > 0
        picture[seen] = shown[seen] / np.float32(255.0)  # grey spreads over the three
    return picture


def _points(source: MapSource, keys: list[tuple[int, int]], T_plane_frame: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Points (N, 3) m in the plane and labels (N,) of some regions."""
    held = [voxels for key in keys if key in source.keys and (voxels := source.voxels(key)) is not None]
    points = np.concatenate([np.zeros((0, 3)), *(voxels.points_enu for voxels in held)])
    return se3.transform(T_plane_frame, points), np.concatenate([np.zeros(0, np.uint8), *(voxels.label for voxels in held)])


def _paint(picture: Picture, points: FloatArray, label: NDArray[np.uint8], low: FloatArray, pixel_m: float) -> None:
    """Dots in the colours of classes, the higher over the lower; the ground's let the photograph shine through."""
    order = np.argsort(points[:, 2], kind="stable")
    at, label = np.floor((points[order, :2] - low) / pixel_m).astype(np.int64), label[order]
    dot = max(round(DOT_M / pixel_m), 1)
    layer, is_ground = np.zeros_like(picture), np.zeros(picture.shape[:2], np.bool_)
    seen = np.zeros(picture.shape[:2], np.bool_)
    for dy in range(dot):
        for dx in range(dot):
            x, y = at[:, 0] + dx - dot // 2, at[:, 1] + dy - dot // 2
            inside = (x >= 0) & (y >= 0) & (x < picture.shape[1]) & (y < picture.shape[0])
            layer[y[inside], x[inside]] = PALETTE_WITH_VOID[label[inside]] / np.float32(255.0)
            is_ground[y[inside], x[inside]] = np.isin(label[inside], GROUND)
            seen[y[inside], x[inside]] = True
    alpha = np.where(is_ground, GROUND_ALPHA, 1.0)[..., None] * seen[..., None]
    picture[:] = picture * (1.0 - alpha) + layer * alpha
