"""A published version of a made map: its tiles as the workers cut them, without the drives."""

from pathlib import Path
from typing import Any

from service_kit.running import ApiAlone
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom.tiles.pyramid import Track, WholeMap, build_tiles
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.updates import updated_tiles


def publish_map(
    database: Database,
    blobs: BlobStore,
    city: VoxelMap,
    tracks: list[Track],
    settings: TileSettings = TileSettings(),
    parked: VoxelMap | None = None,
    drives: tuple[str, ...] = (),
    **more: Any,
) -> list[TileEntry]:
    """The next version of the map `city`, and its tiles; `parked` are the voxels of that overlay."""
    assert city.frame is not None
    tiles = list(build_tiles(city, city.frame, settings, tracks))
    if parked is not None:
        whole = WholeMap(parked, city.frame, settings, ())
        tiles += [tile for tile in updated_tiles(whole.blocks, whole, settings, "parked") if tile.layer in SERVED_LAYERS]
    entries = [
        TileEntry(tile.layer, tile.z, tile.x, tile.y, blobs.put(tile.data), tile.media_type, len(tile.data)) for tile in tiles
    ]
    bounds = box_of(wgs84.lonlatheight_from_enu(city.points_enu, city.frame)[:, :2])
    frame = city.frame.lon_deg, city.frame.lat_deg, city.frame.height_m
    with database.write() as session:
        base = maps.ensure_map(session, "city").version
        publish(session, "city", NewVersion(base, frame, drives, 1, bounds, entries, **more), kept=5)
    return entries


def served_map(
    folder: Path,
    city: VoxelMap,
    tracks: list[Track],
    settings: TileSettings = TileSettings(),
    parked: VoxelMap | None = None,
    **variables: str,
) -> ApiAlone:
    """An API process with one version."""
    alone = ApiAlone(folder, **variables)
    url = variables.get("WAYLOOM_DATABASE_URL", f"sqlite:///{folder / 'wayloom.db'}")
    database = Database(url)
    publish_map(database, BlobStore(folder / "blobs"), city, tracks, settings, parked)
    database.close()
    return alone
