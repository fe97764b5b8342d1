"""Files of a region's features (markings and kerbs, areas, objects): GeoJSON feature collections, and what readers ask of them."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from wayloom.errors import InputError
from wayloom.geodesy.antimeridian import box_of
from wayloom.stitching.region_grid import LonLatBox

AROUND_M: Final = 16.0
"""How far around a region its markings are looked for, and how far features reach beyond it at most: further than symbols and most
crossings."""


def encode_features(features: Sequence[Mapping[str, Any]]) -> bytes:
    """The bytes of a collection: equal features give equal bytes."""
    return json.dumps({"type": "FeatureCollection", "features": list(features)}, separators=(",", ":")).encode()


def read_features(data: bytes, name: str = "features") -> list[dict[str, Any]]:
    """The inverse of `encode_features`. Raises InputError for bytes that are none."""
    try:
        features: list[dict[str, Any]] = json.loads(data)["features"]
    except (ValueError, KeyError, TypeError) as error:
        message = f"are no features of a region or are damaged ({error})"
        raise InputError(message, file=name, remedy="have the map stitched anew") from error
    return features


def lines_of(geometry: Mapping[str, Any]) -> list[list[list[float]]]:
    """The lines of a LineString, a MultiLineString, or a polygon's rings; a point as a line of one: places of longitude, latitude,
    height."""
    coordinates: list[Any] = geometry["coordinates"]
    return {"LineString": [coordinates], "Point": [[coordinates]]}.get(geometry["type"], coordinates)


def bounds_of(feature: Mapping[str, Any]) -> LonLatBox:
    """Degrees around a feature; across the antimeridian east is over 180."""
    return box_of(np.array([place[:2] for line in lines_of(feature["geometry"]) for place in line], np.float64))
