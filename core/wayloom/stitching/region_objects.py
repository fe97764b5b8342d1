"""Objects of a region of the map, fused from the sightings along all submaps that bear on it.

Sightings of one object lie within metres of it, and all that lie so near a region are given. So neighbouring regions, each with
more sightings around, fuse the objects near their border alike, and each object is in the region in which it lies.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from wayloom.geodesy.map_frame import MapFrame
from wayloom.objects.exports import feature
from wayloom.objects.fusion import fuse
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import MapObject, PlacedSightings
from wayloom.stitching.marking_files import encode_features
from wayloom.stitching.region_grid import REGION_M, RegionKey

PLACES_M: Final = 0.001
"""Positions are rounded to so much, so that two regions put the same object into the same of both."""


def region_objects(
    key: RegionKey, sightings: Sequence[PlacedSightings], frame: MapFrame, settings: ObjectFusionSettings
) -> bytes | None:
    """The feature collection of the objects that lie in a region, as JSON; None where it has none."""
    features = [_feature(one, key, frame) for one in fuse(sightings, settings) if _region(one) == key]
    return encode_features(features) if features else None


def _region(one: MapObject) -> RegionKey:
    east, north = np.floor(np.rint(one.position[:2] / PLACES_M) * PLACES_M / REGION_M).astype(int).tolist()
    return east, north


def _feature(one: MapObject, key: RegionKey, frame: MapFrame) -> dict[str, Any]:
    """Its id names its region, by which it is found again."""
    told = feature(one, frame)
    name = f"{key[0]}.{key[1]}.{one.id}"
    properties = {"id": name, **told["properties"], "drive_count": len(one.drives)}
    return {**told, "id": name, "properties": properties}
