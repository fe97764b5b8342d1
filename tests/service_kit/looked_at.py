"""A served map for pages: made voxels with their tiles, a region that tells its lineage, and a drive that has a way."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from service_kit.made_version import publish_map
from service_kit.running import ApiAlone
from tiles.made_maps import made_map, made_tracks
from wayloom.geodesy import wgs84
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.region_files import encode_region
from wayloom.stitching.region_grid import REGION_M, RegionMap
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.store import drives
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import RegionEntry
from wayloom.store.tables.drives import Drive
from wayloom.tiles.settings import TileSettings

SMALL_TILES = TileSettings(cloud_points_per_tile=1000)


@dataclass
class LookedAt:
    """The API, the map that it serves, and the drive."""

    api: ApiAlone
    city: VoxelMap
    drive_id: str

    def publish(self, city: VoxelMap, **more: Any) -> None:
        """The next version, of other voxels; its regions stay."""
        self.city = city
        database = Database(f"sqlite:///{self.api.data / 'wayloom.db'}")
        publish_map(database, BlobStore(self.api.data / "blobs"), city, made_tracks(city), SMALL_TILES, **more)
        database.close()


def looked_at(folder: Path, voxels: int = 6000, extent_m: float = 60.0, parked: VoxelMap | None = None) -> LookedAt:
    """A square of made voxels, whose first drive is known and went through its middle."""
    api = ApiAlone(folder)
    blobs, database = BlobStore(folder / "blobs"), Database(f"sqlite:///{folder / 'wayloom.db'}")
    city = made_map(voxels, extent_m=extent_m)
    with database.write() as session:
        manifest = Manifest(name="north street", vehicle_id="bus 1", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive = drives.register(session, manifest, "city")[0]
        drive.state, drive.placed, drive.track = "done", True, way_through(city)
        drive_id = drive.id
    city = replace(city, drive_ids=(drive_id, *city.drive_ids[1:]))
    regions = [region_of(city, east, north, blobs, drive_id) for east, north in squares(city)]
    publish_map(
        database,
        blobs,
        city,
        made_tracks(city),
        SMALL_TILES,
        parked=parked,
        regions=regions,
        drives=(drive_id,),
        built_with="8" * 64,
    )
    with database.write() as session:
        found = session.get(Drive, drive_id)
        assert found is not None
        found.state = "done"
    database.close()
    return LookedAt(api, city, drive_id)


def way_through(city: VoxelMap) -> list[list[float]]:
    """Longitude, latitude and height from west to east through the middle, a place every two metres."""
    assert city.frame is not None
    low, high = city.points_enu.min(axis=0), city.points_enu.max(axis=0)
    east = np.arange(low[0], high[0], 2.0)
    places = np.column_stack([east, np.full(len(east), 0.5 * (low[1] + high[1])), np.full(len(east), low[2])])
    found: list[list[float]] = wgs84.lonlatheight_from_enu(places, city.frame).tolist()
    return found


def squares(city: VoxelMap) -> Sequence[tuple[int, int]]:
    """The regions that have voxels."""
    found = np.unique(np.floor(city.points_enu[:, :2] / REGION_M).astype(int), axis=0)
    return [(int(east), int(north)) for east, north in found]


def region_of(city: VoxelMap, east: int, north: int, blobs: BlobStore, drive_id: str) -> RegionEntry:
    """A region of the static layer, made of one submap of the drive."""
    assert city.frame is not None
    rows = np.flatnonzero((np.floor(city.points_enu[:, :2] / REGION_M).astype(int) == (east, north)).all(axis=1))
    empty = city.take(np.zeros(0, np.int64))
    region = RegionMap((east, north), {name: city.take(rows) if name == "static" else empty for name in LAYERS})
    content = encode_region(region, city.frame)
    return RegionEntry(east, north, "7" * 64, blobs.put(content), [[drive_id, "a" * 64]], len(content))
