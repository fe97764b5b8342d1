"""Files of a region's markings and kerbs: GeoJSON feature collections, and what readers ask of their features."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from wayloom.errors import InputError

AROUND_M: Final = 16.0
"""How far around a region its markings are looked for, and how far they reach at most: further than symbols and most crossings."""


def encode_features(features: Sequence[Mapping[str, Any]]) -> bytes:
    """The bytes of a collection: equal features give equal bytes."""
    return json.dumps({"type": "FeatureCollection", "features": list(features)}, separators=(",", ":")).encode()


def read_features(data: bytes, name: str = "markings") -> list[dict[str, Any]]:
    """The inverse of `encode_features`. Raises InputError for bytes that are none."""
    try:
        features: list[dict[str, Any]] = json.loads(data)["features"]
    except (ValueError, KeyError, TypeError) as error:
        message = f"are no markings of a region or are damaged ({error})"
        raise InputError(message, file=name, remedy="have the map stitched anew") from error
    return features


def lines_of(geometry: Mapping[str, Any]) -> list[list[list[float]]]:
    """The lines of a LineString, a MultiLineString, or a polygon's rings: places of longitude, latitude, height."""
    coordinates: list[Any] = geometry["coordinates"]
    return [coordinates] if geometry["type"] == "LineString" else coordinates
