"""Merge of submaps into the map, region by region: the same bits in any order of arrival, after any earlier merges and removals."""

from collections.abc import Iterable

from wayloom.stitching.points import canonical, frame_of
from wayloom.stitching.regions import REGION_M, RegionKey, fuse_region, regions_of, whole_map
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.submap import PlacedSubmap


def merge(placed: Iterable[PlacedSubmap], settings: MergeSettings = MergeSettings(), edge_m: float = REGION_M) -> VoxelMap:
    """The static layer of all submaps.

    placed : each submap of each drive; one that comes twice counts once
    edge_m : of a region; the map is the same whatever it is
    Raises StageError when the submaps are of different frames, or lie beyond KEY_LIMITS voxels from the frame's origin.
    """
    items = canonical(placed)
    submaps_of: dict[RegionKey, list[PlacedSubmap]] = {}
    for item in items:
        for key in regions_of(item, settings, edge_m):
            submaps_of.setdefault(key, []).append(item)
    regions = [fuse_region(key, submaps_of[key], settings, edge_m) for key in sorted(submaps_of)]
    return whole_map(regions, frame_of(items), settings)
