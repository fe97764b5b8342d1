"""Objects as GeoJSON: `objects.geojson` of one drive, WGS84 with ellipsoidal heights (RFC 7946)."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.files.atomic import write_atomically
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.objects.files import load_one, read_index
from wayloom.objects.fusion import fuse
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import MapObject, PlacedSightings
from wayloom.submaps.submap import PlacedSubmap

OBJECTS_FILE: Final = "objects.geojson"
MILLIMETRES: Final = 3
DEGREES: Final = 9


def placed_sightings(sightings_dir: Path, submaps: Sequence[PlacedSubmap]) -> list[PlacedSightings]:
    """What a drive saw along its submaps, at their places. Raises InputError for a damaged file."""
    index = read_index(sightings_dir)
    return [
        PlacedSightings(load_one(sightings_dir, index[one.submap.digest]), one.T_enu_submap, one.covariance, one.drive_id)
        for one in submaps
        if one.submap.digest in index
    ]


def objects_of_drive(sightings_dir: Path, submaps: Sequence[PlacedSubmap], settings: ObjectFusionSettings) -> list[MapObject]:
    """The objects of one drive, each once, in the frame of its submaps' places. Raises InputError for a damaged file."""
    return fuse(placed_sightings(sightings_dir, submaps), settings)


def export_objects(objects: Sequence[MapObject], frame: MapFrame, path: Path) -> None:
    """Write objects in `frame`."""
    content = {"type": "FeatureCollection", "features": [feature(one, frame) for one in objects]}
    write_atomically(path, json.dumps(content).encode())


def feature(one: MapObject, frame: MapFrame) -> dict[str, Any]:
    """An object as a GeoJSON feature; sigmas and covariance are those of its place in the map, east, north and up."""
    ((lon, lat, height),) = wgs84.lonlatheight_from_enu(one.position[None], frame).tolist()
    C = one.covariance
    told: dict[str, Any] = {
        "kind": one.kind,
        "confidence": round(one.confidence, MILLIMETRES),
        "bottom_m": round(one.bottom_m, MILLIMETRES),
        "height_m": round(one.height_m, MILLIMETRES),
        "width_m": round(one.width_m, MILLIMETRES),
        "sigma_m": round(float(np.sqrt(max(np.linalg.eigvalsh(C[:2, :2])[-1], 0.0))), MILLIMETRES),
        "sigma_up_m": round(float(np.sqrt(max(C[2, 2], 0.0))), MILLIMETRES),
        "covariance_m2": [float(f"{C[i, j]:.3g}") for i in range(3) for j in range(i, 3)],
        "drives": list(one.drives),
        "looks": one.looks,
        "first_ns": one.first_ns,
        "last_ns": one.last_ns,
    }
    if one.facing_rad is not None and one.facing_sigma_rad is not None:
        told |= {
            "facing_deg": round(float(np.degrees(one.facing_rad)), 1),
            "facing_sigma_deg": round(float(np.degrees(one.facing_sigma_rad)), 1),
        }
    place = [round(lon, DEGREES), round(lat, DEGREES), round(height, MILLIMETRES)]
    return {"type": "Feature", "id": one.id, "geometry": {"type": "Point", "coordinates": place}, "properties": told}
