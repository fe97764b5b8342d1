"""Versions of a map whose regions are those of drives on disk, published in a service's own database and blob store."""

from pathlib import Path

from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.ground.merge import merge_sheets
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.region_files import encode_region
from wayloom.stitching.region_grid import REGION_M, RegionKey, RegionMap, region_edges
from wayloom.stitching.voxel_map import joined_maps
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.map_versions import NewVersion, RegionEntry, TileEntry, publish
from wayloom.tiles.pyramid import build_tiles


def region_entry(drives: DriveOutputs, key: RegionKey, blobs: BlobStore) -> RegionEntry:
    """A region with its voxels, ground and markings."""
    assert drives.frame is not None
    empty = joined_maps([], drives.frame, drives.voxel_m)
    layers = dict.fromkeys(LAYERS, empty) | {LAYERS[0]: drives.voxels(key) or empty}
    data = encode_region(RegionMap(key, layers), drives.frame)
    ground = drives._ground._file(key) if key in drives._ground.keys else None
    held = merge_sheets(drives._ground._near[key], region_edges(key)[0], REGION_M) if ground is not None else None
    found = drives._of_region("markings", key)
    return RegionEntry(
        *key, "1" * 64, blobs.put(data), [["a" * 64, "2" * 64]], len(data), [],
        "" if held is None else blobs.put(held.encoded()), "" if found is None else blobs.put(found),
    )  # fmt: skip


def publish_drives(data: Path, drives: DriveOutputs, map_id: str = "city") -> None:
    """The first version of a map, with its tiles."""
    database, blobs, frame = Database(f"sqlite:///{data / 'wayloom.db'}"), BlobStore(Folders(data).blobs), drives.frame
    assert frame is not None
    regions = [region_entry(drives, key, blobs) for key in drives.keys]
    parts = [found for key in drives.keys if (found := drives.voxels(key)) is not None]
    tiles = build_tiles(joined_maps(parts, frame, drives.voxel_m), frame)
    entries = [TileEntry(one.layer, one.z, one.x, one.y, blobs.put(one.data), one.media_type, len(one.data)) for one in tiles]
    with database.write() as session:
        maps.ensure_map(session, map_id)
        origin = (frame.lon_deg, frame.lat_deg, frame.height_m)
        publish(session, map_id, NewVersion(0, origin, ("a" * 64,), 0, None, entries, regions=regions), kept=5)
    database.close()
