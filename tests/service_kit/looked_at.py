"""A served map for pages: made voxels with their tiles, a region that tells its lineage, and a drive that has a way."""

from collections.abc import Iterator, Sequence
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
from wayloom.store.tables.drives import Drive, SubmapRow
from wayloom.tiles.settings import TileSettings

NS_PER_DAY = 86_400 * 10**9
FIRST_DAY_NS = 1_780_300_800 * 10**9
"""The first of June 2026, at eight."""
SMALL_TILES = TileSettings(cloud_points_per_tile=1000)


@dataclass
class LookedAt:
    """The API, the map that it serves, the drive that is known, and all drives of the map."""

    api: ApiAlone
    city: VoxelMap
    drive_id: str
    held: tuple[str, ...] = ()

    def publish(self, city: VoxelMap, **more: Any) -> None:
        """The next version, of other voxels; its regions stay."""
        self.city = city
        database = Database(f"sqlite:///{self.api.data / 'wayloom.db'}")
        publish_map(database, BlobStore(self.api.data / "blobs"), city, made_tracks(city), SMALL_TILES, drives=self.held, **more)
        database.close()


def looked_at(
    folder: Path,
    voxels: int = 6000,
    extent_m: float = 60.0,
    parked: VoxelMap | None = None,
    away_m: float = 0.0,
    changes: bool = False,
) -> LookedAt:
    """A square of made voxels, whose first drive is known and went through its middle; a second one crosses its way.

    away_m  : the second one also went there, so far to the east, where nothing is mapped
    changes : whether a pole is new and a traffic sign has gone, near the middle
    """
    api = ApiAlone(folder)
    blobs, database = BlobStore(folder / "blobs"), Database(f"sqlite:///{folder / 'wayloom.db'}")
    city = made_map(voxels, extent_m=extent_m)
    with database.write() as session:
        manifest = Manifest(name="north street", vehicle_id="bus 1", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive = drives.register(session, manifest, "city")[0]
        drive.state, drive.placed, drive.track = "done", True, way_through(city)
        drive_id = drive.id
        crossing = drives.register(session, replace_name(manifest, "side street"), "city")[0]
        crossing.state, crossing_id = "done", crossing.id
        session.flush()
        session.add_all(submaps_of(city, drive_id, crossing_id, away_m))
    city = replace(city, drive_ids=(drive_id, *city.drive_ids[1:]))
    regions = [region_of(city, east, north, blobs, drive_id) for east, north in squares(city)]
    if changes:
        regions[0] = replace(regions[0], changes=list(changed_things()))
    held = (drive_id, crossing_id)
    more: dict[str, Any] = {"regions": regions, "drives": held, "built_with": "8" * 64}
    publish_map(database, blobs, city, made_tracks(city), SMALL_TILES, parked=parked, **more)
    with database.write() as session:
        for known in held:
            found = session.get(Drive, known)
            assert found is not None
            found.state = "done"
    database.close()
    return LookedAt(api, city, drive_id, held)


def replace_name(manifest: Manifest, name: str) -> Manifest:
    return manifest.model_copy(update={"name": name})


def submaps_of(city: VoxelMap, along: str, across: str, away_m: float) -> Sequence[SubmapRow]:
    """The ways of two drives, as rows of the store: from west to east, and, a day later, from south to north."""
    east = [place[:2] for place in way_through(city)]
    middle_lon, middle_lat = east[len(east) // 2]
    north = [[middle_lon, middle_lat - 0.0005], [middle_lon, middle_lat + 0.0005]]
    ways = [(along, 0, east, FIRST_DAY_NS), (across, 0, north, FIRST_DAY_NS + NS_PER_DAY)]
    if away_m:
        shift = away_m / (111_320.0 * np.cos(np.radians(middle_lat)))
        ways.append((across, 1, [[lon + shift, lat] for lon, lat in north], FIRST_DAY_NS + NS_PER_DAY))
    return [submap_row(*way) for way in ways]


def submap_row(drive_id: str, position: int, way: list[list[float]], t_ns: int) -> SubmapRow:
    places = np.array(way)
    (west, south), (east, north) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return SubmapRow(
        drive_id=drive_id, position=position, map_id="city", digest="a" * 64, point_count=1, frame=None,
        T_enu_submap=np.eye(4).tolist(), covariance=np.eye(6).tolist(), track=way, track_t_ns=t_ns,
        min_lon=west, min_lat=south, max_lon=east, max_lat=north,
        near_min_lon=west, near_min_lat=south, near_max_lon=east, near_max_lat=north,
    )  # fmt: skip


def changed_things() -> Iterator[dict[str, Any]]:
    """GeoJSON of a pole that is new and, two metres away, a traffic sign that has gone."""
    for kind, name, lon, day in (("new", "pole", 8.39, 2), ("gone", "traffic sign", 8.39003, 1)):
        properties = {"kind": kind, "class": name, "noticed": f"2026-06-0{day}T08:00:00.000Z"}
        yield {"type": "Feature", "geometry": {"type": "Point", "coordinates": [lon, 48.98, 115.0]}, "properties": properties}


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
