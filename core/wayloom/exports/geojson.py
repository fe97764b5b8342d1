"""GeoJSON (RFC 7946) of a map's features: WGS84, ellipsoidal heights, each feature with its collection's name."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from wayloom.config.progress import Progress, silent
from wayloom.exports.features import read_collection, wanted_collections
from wayloom.exports.source import MapSource
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.antimeridian import Box


def write_geojson(
    path: Path, source: MapSource, box: Box | None, names: Sequence[str], provenance: Mapping[str, Any], progress: Progress = silent
) -> dict[str, int]:
    """Write the collections of these names, all for none; how many features each has. Raises InputError, OSError."""
    counts: dict[str, int] = {}

    def parts() -> Iterator[bytes]:
        yield b'{"type":"FeatureCollection","provenance":' + _text(provenance) + b',"features":['
        for name in wanted_collections(names):
            counts[name] = 0
            for feature in read_collection(name, source, box, progress):
                told = {**feature, "properties": {"collection": name, **feature["properties"]}}
                yield (b",\n" if sum(counts.values()) else b"\n") + _text(told)
                counts[name] += 1
        yield b"]}\n"

    write_atomically(path, parts())
    return counts


def _text(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
