"""A version of a service's map as the source of an export: its regions are fetched when they are asked for."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.client.api import Api
from wayloom.client.drives import all_drives
from wayloom.exports.boxes import inside
from wayloom.exports.provenance import provenance_of
from wayloom.exports.source import Feature
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box, rolled
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.ground_map import GroundFile
from wayloom.stitching.layer_names import LAYERS, STATIC
from wayloom.stitching.marking_files import lines_of, read_features
from wayloom.stitching.region_files import decode_region
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.feature_layers import FEATURE_LAYERS
from wayloom.tiles.grid import unit_from_lonlat
from wayloom.tiles.pyramid import Track

FloatArray = NDArray[np.float64]
HELD_REGIONS, HELD_RASTERS = 16, 48
LINEAGE_ZOOM: Final = 14


class ServedMap:
    """`exports.source.MapSource` of a published version.

    number : None is the newest. Raises AnswerError where there is no such map or version, ServiceError.
    """

    def __init__(self, api: Api, map_id: str, number: int | None = None, box: Box | None = None) -> None:
        newest = f"/v1/maps/{map_id}"
        self._api, self._map_path = api, newest
        self._version: dict[str, Any] = api.json("GET", newest if number is None else f"{newest}/versions/{number}")
        self._path = f"{newest}/versions/{self._version['version']}"
        self._query = {} if box is None else {"bbox": f"{box[0]!r},{box[1]!r},{rolled(box[2])!r},{box[3]!r}"}
        self._box = box
        listed = api.json("GET", f"{self._path}/regions", params=self._query)
        self.frame: MapFrame | None = MapFrame(*listed["frame"])
        self._frame, self._built_with = MapFrame(*listed["frame"]), str(listed["built_with"])
        self._parts: dict[RegionKey, Mapping[str, Any]] = {(one["east"], one["north"]): one for one in listed["regions"]}
        self.keys: Sequence[RegionKey] = sorted(self._parts)
        self._region = lru_cache(HELD_REGIONS)(self._fetched_region)
        self._ground = lru_cache(HELD_REGIONS)(self._fetched_ground)
        self._raster = lru_cache(HELD_RASTERS)(self._unpacked)
        self._features = cache(self._fetch)  # some kilobytes a region

    @cached_property
    def voxel_m(self) -> float:
        """Edge of the voxels; of a map without any a metre."""
        return self._region(self.keys[0]).voxel_m if self.keys else 1.0

    @cached_property
    def place(self) -> FloatArray:
        """A voxel in the middle region."""
        if not self.keys:
            return np.zeros(3)
        middle = sorted(self.keys, key=self._from_middle)[0]
        voxels = self._region(middle)
        level = float(np.median(voxels.points_enu[:, 2])) if len(voxels) else 0.0
        return np.append(region_edges(middle)[0] + REGION_M / 2.0, level)

    def _from_middle(self, key: RegionKey) -> float:
        return float(np.linalg.norm(np.array(key) - np.median(np.array(self.keys), axis=0)))

    def voxels(self, key: RegionKey) -> VoxelMap | None:
        """The static layer of a region."""
        return self._region(key) if key in self._parts else None

    def _fetched_region(self, key: RegionKey) -> VoxelMap:
        return decode_region(self._fetch(key, "voxels"), f"region {key}").layers[LAYERS[STATIC]]

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of a region's ground; None where it has none."""
        return self._raster(key, name) if self._has(key, "ground") else None

    def _unpacked(self, key: RegionKey, name: str) -> NDArray[Any]:
        return self._ground(key).raster(name)

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """Of the sheets of a region's ground."""
        return self._ground(key).place_sigma_mm if self._has(key, "ground") else np.zeros(0, np.uint16)

    def _fetched_ground(self, key: RegionKey) -> GroundFile:
        return GroundFile(self._fetch(key, "ground"), f"ground {key}")

    def features(self, name: str, key: RegionKey) -> Sequence[Feature]:
        """The features of a collection that belong to a region."""
        return read_features(self._features(key, name), str(key)) if name in FEATURE_LAYERS and self._has(key, name) else ()

    def _has(self, key: RegionKey, part: str) -> bool:
        return bool(self._parts.get(key, {}).get(part))

    def _fetch(self, key: RegionKey, part: str) -> bytes:
        return self._api.content(f"{self._path}/regions/{key[0]}/{key[1]}/{part}")

    def tracks(self) -> Iterator[Track]:
        """The tracks of the version's drives, as the newest version places them, submap by submap, at the height of `place`."""
        drives, height = set(self._version["drives"]), wgs84.lonlatheight_from_enu(self.place[None], self._frame)[0, 2]
        for feature in self._api.json("GET", f"{self._map_path}/tracks", params=self._query)["features"]:
            drive_id = feature["properties"]["drive_id"]
            for line in lines_of(feature["geometry"]) if drive_id in drives else ():
                lon_lat = np.array(line, np.float64)[:, :2]
                lon_lat = lon_lat[inside(lon_lat, self._box)]
                places = np.column_stack([lon_lat, np.full(len(lon_lat), height)])
                yield Track(drive_id, wgs84.enu_from_lonlatheight(places, self._frame))

    def doubts(self) -> Mapping[str, Sequence[str]]:
        """What the service says of the version's drives that warn of something."""
        drives = set(self._version["drives"])
        return {one["id"]: one["warnings"] for one in all_drives(self._api) if one["id"] in drives and one["warnings"]}

    def provenance(self) -> Mapping[str, Any]:
        """Drives by the hashes of their uploads, with the runs that made them, from the version's lineage."""
        drives: dict[str, Any] = {}
        for x, y in self._lineage_tiles():
            answer = self._api.json("GET", f"{self._path}/lineage", params={"tile": f"{LINEAGE_ZOOM}/{x}/{y}"})
            drives |= {one["id"]: _origin(one) for one in answer["drives"]}
        of_version = ("map_id", "version", "created_at", "facts")
        parameters = {name: self._version[name] for name in of_version if name in self._version}
        return provenance_of(self._api.url, [drives[name] for name in sorted(drives)], self.frame, parameters, self._built_with)

    def _lineage_tiles(self) -> list[tuple[int, int]]:
        """Columns and rows of the tiles that the regions touch."""
        if not self.keys:
            return []
        corners = np.array([[*corner, self.place[2]] for key in self.keys for corner in region_edges(key)])
        places = wgs84.lonlatheight_from_enu(corners, self._frame)[:, :2]
        tiles = np.floor(unit_from_lonlat(places) * (1 << LINEAGE_ZOOM)).astype(int)
        return sorted({(x, y) for x, y in tiles.tolist()})


def _origin(drive: Mapping[str, Any]) -> dict[str, Any]:
    """A drive of the lineage: its id is the SHA-256 of its manifest, which names that of each file."""
    run = drive.get("run") or {}
    found = {"id": drive["id"], "sha256": {"manifest": drive["id"]}, "name": drive.get("name"), "network": run.get("network")}
    code = {stage["stage"]: stage["code"] for stage in run.get("stages", []) if "stage" in stage and "code" in stage}
    return {name: value for name, value in (found | {"code": code}).items() if value}
