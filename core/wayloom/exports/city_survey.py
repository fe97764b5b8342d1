"""Survey of a map from above, region by region: where it has points, of which classes, and the drives' tracks, in one plane."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, PALETTE_WITH_VOID, VOID
from wayloom.exports.boxes import inside
from wayloom.exports.points import batch_of_voxels, cut
from wayloom.exports.source import MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges
from wayloom.tiles.pyramid import Track

FloatArray = NDArray[np.float64]
MOST_PIXELS: Final = 1600
FINEST_M: Final = 0.15
HEIGHT_STEP_M: Final = 0.01
LIVELY: Final = tuple(CLASS_ID[name] for name in ("pole", "traffic light", "traffic sign", "building", "vegetation", "sidewalk"))
"""Classes that make an inset worth looking at."""
THICK_BELOW_M: Final = 0.6
FEW: Final = 10
"""Voxels from which a class counts as seen in a region."""


@dataclass(frozen=True, slots=True)
class PlaneTrack:
    """A drive's id and its camera's places (K, 3) m in the survey's plane."""

    drive_id: str
    points: FloatArray


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """A region: its middle (2,) m in the plane, how many points, how many lively classes."""

    key: RegionKey
    middle: FloatArray
    points: int
    classes: int


@dataclass(slots=True)
class Survey:
    """A map from above.

    T_plane_frame  (4, 4) from the map's frame to the plane: east, north, up at the map's place; a drive's own without frame
    north_up       whether the plane is geographic; place_text names its origin
    pixel_m, corner  of the raster: (2,) m of its lowest pixel
    seen           (H, W) train id of the highest point, 255 where there is none; rows go north
    counts         (256,) points of each label
    low, high      (2,) m of what is shown
    """

    T_plane_frame: FloatArray
    north_up: bool
    place_text: str
    pixel_m: float
    corner: FloatArray
    seen: NDArray[np.uint8]
    height: NDArray[np.float32]
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, np.int64))
    low: FloatArray = field(default_factory=lambda: np.full(2, np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(2, -np.inf))
    regions: list[SeenRegion] = field(default_factory=list)
    tracks: Sequence[PlaneTrack] = ()

    @property
    def count(self) -> int:
        """All points."""
        return int(self.counts.sum())

    def picture(self, covered: str) -> FloatArray:
        """(H, W, 4) RGBA: classes, and around them, where a pixel is small, the colour of what is covered."""
        out = np.zeros((*self.seen.shape, 4))
        shown = _thickened(self.seen) if self.pixel_m < THICK_BELOW_M else self.seen
        known = shown != VOID
        out[known, :3], out[known, 3] = PALETTE_WITH_VOID[shown[known]] / 255.0, 1.0
        around = _grown(known, max(1, round(2.0 / self.pixel_m))) & ~known
        out[around, :3], out[around, 3] = to_rgb(covered), 1.0
        return out


def surveyed(source: MapSource, box: Box | None) -> Survey:
    """Look at every region once."""
    survey = _empty(source)
    for key in source.keys:
        voxels = source.voxels(key)
        if voxels is not None and len(voxels):
            batch = cut(batch_of_voxels(voxels), source.frame, box)
            if len(batch):
                _add(survey, key, se3.transform(survey.T_plane_frame, batch.points), batch.label)
    shown = ((track.drive_id, _shown(track, source, box)) for track in source.tracks())
    T = survey.T_plane_frame
    survey.tracks = [PlaneTrack(drive_id, se3.transform(T, points)) for drive_id, points in shown if len(points) > 1]
    for track in survey.tracks:
        _widen(survey, track.points)
    return survey


def _shown(track: Track, source: MapSource, box: Box | None) -> FloatArray:
    """The places of a track within the box."""
    if box is None or source.frame is None:
        return track.points_enu
    return track.points_enu[inside(wgs84.lonlatheight_from_enu(track.points_enu, source.frame), box)]


def level_plane(source: MapSource) -> tuple[FloatArray, str]:
    """(4, 4) from the map's frame to east, north, up at the map's place, and the place in words; of a map without frame its own."""
    if source.frame is None:
        return np.eye(4), ""
    origin = MapFrame(*wgs84.lonlatheight_from_enu(source.place[None], source.frame)[0].tolist())
    place = f"{abs(origin.lat_deg):.4f}° {'NS'[origin.lat_deg < 0]}, {abs(origin.lon_deg):.4f}° {'EW'[origin.lon_deg < 0]}"
    return wgs84.T_enu_enu(origin, source.frame), place


def _empty(source: MapSource) -> Survey:
    T, place_text = level_plane(source)
    corners = np.array([[x, y, source.place[2]] for key in source.keys for x, y in region_edges(key)])
    places = se3.transform(T, corners.reshape(-1, 3))[:, :2] if len(corners) else np.zeros((1, 2))
    low, high = places.min(axis=0) - 1.0, places.max(axis=0) + REGION_M
    pixel_m = max(float((high - low).max()) / MOST_PIXELS, FINEST_M)
    width, height = (np.ceil((high - low) / pixel_m).astype(int) + 1).tolist()
    seen, heights = np.full((height, width), VOID, np.uint8), np.full((height, width), -np.inf, np.float32)
    return Survey(T, source.frame is not None, place_text, pixel_m, low, seen, heights)


def _add(survey: Survey, key: RegionKey, points: FloatArray, label: NDArray[np.uint8]) -> None:
    column, row = np.floor((points[:, :2] - survey.corner) / survey.pixel_m).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < survey.seen.shape[1]) & (row < survey.seen.shape[0])
    order = np.argsort(points[:, 2], kind="stable")
    order = order[inside[order]]
    higher = points[order, 2] > survey.height[row[order], column[order]]
    order = order[higher]
    survey.seen[row[order], column[order]] = label[order]
    survey.height[row[order], column[order]] = points[order, 2]
    found = np.bincount(label, minlength=256)
    survey.counts += found
    _widen(survey, points)
    classes = int((found[list(LIVELY)] >= FEW).sum())
    survey.regions.append(SeenRegion(key, np.median(points[:, :2], axis=0), len(points), classes))


def _widen(survey: Survey, points: FloatArray) -> None:
    """Show these too."""
    survey.low, survey.high = np.minimum(survey.low, points[:, :2].min(axis=0)), np.maximum(survey.high, points[:, :2].max(axis=0))


def _thickened(seen: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Each pixel that shows nothing shows what its western, else its southern neighbour does: single points are seen better."""
    out = seen.copy()
    for axis in (1, 0):
        moved = np.roll(out, 1, axis)
        out = np.where(out == VOID, moved, out)
    return out


def _grown(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * pixels + 1, 2 * pixels + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel) > 0)
