"""Merge of submaps into the map, region by region: the same bits in any order of arrival, after any earlier merges and removals."""

from collections.abc import Iterable

from wayloom.stitching.placed_looks import PlacedLooks
from wayloom.stitching.points import canonical, frame_of
from wayloom.stitching.region_grid import REGION_M, RegionKey
from wayloom.stitching.regions import fuse_region, regions_of, whole_map
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.submap import PlacedSubmap


def merge(
    placed: Iterable[PlacedSubmap],
    settings: MergeSettings = MergeSettings(),
    edge_m: float = REGION_M,
    looks: Iterable[PlacedLooks] = (),
) -> VoxelMap:
    """The static layer of all submaps.

    placed : each submap of each drive; one that comes twice counts once
    looks  : of as many of these submaps as have them: what has gone is left out
    edge_m : of a region; the map is the same whatever it is
    Raises StageError when the submaps are of different frames, or lie beyond KEY_LIMITS voxels from the frame's origin.
    """
    items, seen = canonical(placed), list(looks)
    submaps_of: dict[RegionKey, list[PlacedSubmap]] = {}
    for item in items:
        for key in regions_of(item, settings, edge_m):
            submaps_of.setdefault(key, []).append(item)
    regions = [fuse_region(key, submaps_of[key], settings, edge_m, seen) for key in sorted(submaps_of)]
    return whole_map(regions, frame_of(items), settings)
