"""Map for notebooks: outputs of drives, a service's map or a folder of tiles, as arrays, features and GeoDataFrames."""

import weakref
from collections.abc import Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from wayloom.client.api import Api
from wayloom.client.served_map import ServedMap
from wayloom.errors import InputError
from wayloom.exports.boxes import checked_box
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.features import COLLECTIONS, read_collection, wanted_collections
from wayloom.exports.formats import Export, export_map
from wayloom.exports.points import PointBatch, joined_batches, map_batches
from wayloom.exports.source import Feature, MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import moved_covariance
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.sheet import CELL_M
from wayloom.notebook import frames
from wayloom.notebook.drive import Drive, FloatArray, Trajectory
from wayloom.notebook.tile_folder import TileFolder, is_tile_folder
from wayloom.stitching.region_grid import REGION_M
from wayloom.stitching.settings import MergeSettings

if TYPE_CHECKING:
    import geopandas

VERTICAL_STEPS: Final = 2
"""The map's third axis leans by at most a degree or two, so a first height is right to centimetres and a second to less."""


class Map:
    """A semantic map. Nothing is read before it is asked for.

    where   : a folder that `wayloom process` wrote, or several: they are fused where their own geo-reference places them; the
              address of a service; or a folder of its tiles (`wayloom sync`)
    city    : which map of a service; version None is the newest; key: else WAYLOOM_API_KEY
    bbox    : west, south, east, north in degrees: what lies in it alone
    voxel_m : edge of the voxels of fused drives

    Raises InputError for a folder that is none of these, AnswerError and ServiceError of a service.
    """

    def __init__(
        self, *where: str | PathLike[str], city: str = "city", version: int | None = None, key: str | None = None,
        bbox: Sequence[float] | None = None, voxel_m: float = 0.1,
    ) -> None:  # fmt: skip
        if not where:
            raise InputError("nothing to open", remedy='wayloom.Map("out") or wayloom.Map("http://127.0.0.1:8088")')
        self._box = None if bbox is None else checked_box(bbox)
        self._source: MapSource | None = None
        self._tiles: TileFolder | None = None
        self._folders = [Path(one) for one in where if "://" not in str(one)]
        if not self._folders and len(where) == 1:
            api = Api(str(where[0]), key)
            self._source = ServedMap(api, city, version, self._box)
            weakref.finalize(self._source, api.close)
        elif len(self._folders) == 1 and is_tile_folder(self._folders[0]):
            self._tiles = TileFolder(self._folders[0], self._box)
        elif len(self._folders) == len(where):
            self._source = DriveOutputs(self._folders, MergeSettings(voxel_m=voxel_m), self._box)
        else:
            raise InputError("addresses and folders do not mix", remedy="open one service, or folders alone")

    @property
    def source(self) -> MapSource:
        """The map as exporters see it, region by region: for what is too large to hold. Raises InputError for tiles."""
        if self._source is None:
            raise InputError("tiles tell of points alone", file=self._folders[0], remedy="open the service that they are from")
        return self._source

    @property
    def frame(self) -> MapFrame | None:
        """East, north, up at its origin: the frame of all arrays. None: one drive's own, without a place on Earth."""
        return self._tiles.frame if self._tiles is not None else self.source.frame

    @cached_property
    def voxels(self) -> PointBatch:
        """The static layer, a point a voxel: places (V, 3) m, train ids, sigmas, confidence, drives, times."""
        return self._tiles.points() if self._tiles is not None else joined_batches([*map_batches(self.source, self._box)])

    @cached_property
    def tracks(self) -> dict[str, FloatArray]:
        """(K, 3) m of each drive's camera at its keyframes, by the drive's id."""
        found: dict[str, list[FloatArray]] = {}
        for track in self.source.tracks():
            found.setdefault(track.drive_id, []).append(track.points_enu)
        return {name: np.concatenate(parts) for name, parts in found.items()}

    @cached_property
    def trajectories(self) -> dict[str, Trajectory]:
        """Poses with covariances of each drive, in the map's frame. Raises InputError for what is no folder of a drive."""
        if not isinstance(self._source, DriveOutputs):
            raise InputError("poses with covariances lie in the folders of drives alone", remedy="use tracks")
        drives = [Drive(folder).trajectory for folder in self._folders]
        return {one.drive_id: _moved(one, self.frame) for one in drives}

    def features(self, name: str) -> list[Feature]:
        """GeoJSON features of a collection: objects, areas, markings, kerbs, tracks. Raises InputError that lists the known."""
        (known,) = wanted_collections([name])
        return [*read_collection(known, self.source, self._box)]

    def lonlatheight(self, points_enu: FloatArray) -> FloatArray:
        """(N, 3) degrees, degrees, ellipsoidal m of points (N, 3) m in the frame. Raises InputError without a place on Earth."""
        return wgs84.lonlatheight_from_enu(points_enu, self._earth())

    def ground_height(self, lon_lat: FloatArray) -> FloatArray:
        """(N,) ellipsoidal height of the merged ground, m, under places (N, 2) degrees; NaN where no drive saw the ground."""
        frame, lon_lat = self._earth(), np.asarray(lon_lat, np.float64).reshape(-1, 2)
        height = np.full(len(lon_lat), float(self.lonlatheight(self.source.place[None])[0, 2]))
        for _ in range(VERTICAL_STEPS):
            guess = np.where(np.isfinite(height), height, np.nanmean(height) if np.isfinite(height).any() else 0.0)
            enu = wgs84.enu_from_lonlatheight(np.column_stack([lon_lat, guess]), frame)
            enu[:, 2] = self._ground_z(enu[:, :2])
            height = np.full(len(enu), np.nan)
            seen = np.isfinite(enu[:, 2])
            height[seen] = wgs84.lonlatheight_from_enu(enu[seen], frame)[:, 2]
        return height

    def _ground_z(self, places: FloatArray) -> FloatArray:
        """(N,) m in the frame of the cells that places (N, 2) m lie in; NaN where nothing was seen."""
        regions, found = np.floor(places / REGION_M).astype(np.int64), np.full(len(places), np.nan)
        for key in {(int(east), int(north)) for east, north in regions}:
            heights = self.source.raster(key, "height_mm")
            if heights is not None:
                rows = np.flatnonzero((regions == key).all(axis=1))
                column, row = np.clip(((places[rows] - np.array(key) * REGION_M) / CELL_M).astype(int), 0, len(heights) - 1).T
                cells = heights[row, column]
                found[rows] = np.where(cells == NO_HEIGHT, np.nan, cells / 1000.0)
        return found

    def geo(self, name: str) -> "geopandas.GeoDataFrame":
        """`objects`, `areas`, `markings`, `kerbs`, `tracks` or `voxels` as a GeoDataFrame in WGS84 with ellipsoidal heights.

        Needs the extra `geo`: raises MissingExtraError without it; InputError for another name, which lists the known.
        """
        if name == "voxels":
            return frames.of_points(self.voxels, self.lonlatheight(self.voxels.points))
        return frames.of_features(self.features(name), COLLECTIONS[name].columns)

    def export(self, out: str | PathLike[str], *layers: str) -> str:
        """Write a file or folder whose ending tells the format (docs/exports.md); what was written, in words."""
        return export_map(Export(self.source, Path(out), self._box, layers))

    def _earth(self) -> MapFrame:
        if self.frame is None:
            raise InputError("this drive has no place on Earth", remedy="process it with gnss=…")
        return self.frame

    def __repr__(self) -> str:
        if self._tiles is not None:
            return f"Map(tiles of {self._folders[0]})"
        return f"Map({len(self.source.keys)} regions of {REGION_M:.0f} m, frame {self.frame})"


def _moved(one: Trajectory, frame: MapFrame | None) -> Trajectory:
    """The same poses in another frame."""
    if one.frame is None or frame is None or one.frame == frame:
        return one
    T = wgs84.T_enu_enu(frame, one.frame)
    return Trajectory(one.drive_id, frame, one.t_ns, T @ one.T_enu_cam, moved_covariance(T, one.covariance), one.tracked)
