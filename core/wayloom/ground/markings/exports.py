"""Markings and kerbs of one drive as GeoJSON: `markings.geojson`, WGS84 with ellipsoidal heights (RFC 7946)."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.files.atomic import write_atomically
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import line_geometry
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.markings.find import find_markings
from wayloom.ground.markings.kerbs import find_kerbs
from wayloom.ground.markings.merging import merged_kerbs, merged_markings
from wayloom.ground.markings.raster import raster_of_sheet
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.markings.types import Kerb, Marking
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
MARKINGS_FILE: Final = "markings.geojson"
AREAS: Final = ("zebra", "arrow", "symbol")
MILLIMETRES: Final = 3
DEGREES: Final = 9


def markings_of_drive(
    sheets_dir: Path, submaps: Sequence[PlacedSubmap], markings: MarkingSettings, kerbs: KerbSettings
) -> tuple[list[Marking], list[Kerb]]:
    """All markings and kerbs of a drive in the frame of its submaps' places, each once; one sheet in memory at a time.

    Raises InputError for a damaged sheet.
    """
    T_enu_submap = {item.submap.digest: item.T_enu_submap for item in submaps}
    found, steps = [], []
    for submap, digest in read_index(sheets_dir).items():
        sheet = load_sheet(sheets_dir, digest)
        T_enu_sheet = T_enu_submap[submap] @ sheet.T_submap_sheet
        raster = raster_of_sheet(sheet)
        found += [one.moved(T_enu_sheet) for one in find_markings(raster, markings)]
        steps += [one.moved(T_enu_sheet) for one in find_kerbs(raster, kerbs)]
    return merged_markings(found, markings.solid_m), merged_kerbs(steps, kerbs.least_length_m)


def export_markings(
    sheets_dir: Path, submaps: Sequence[PlacedSubmap], path: Path, markings: MarkingSettings, kerbs: KerbSettings
) -> None:
    """Write the drive's markings and kerbs; nothing for a drive without sheets or a place on Earth. Raises InputError."""
    frame = submaps[0].frame if len(submaps) else None
    if frame is not None and read_index(sheets_dir):
        content = geojson(*markings_of_drive(sheets_dir, submaps, markings, kerbs), frame, submaps)
        write_atomically(path, json.dumps(content).encode())


def geojson(
    markings: Sequence[Marking], kerbs: Sequence[Kerb], frame: MapFrame, submaps: Sequence[PlacedSubmap] = ()
) -> dict[str, Any]:
    """The feature collection of markings and kerbs in `frame`.

    submaps : those that they lie on; their places' sigmas are told beside the markings' own
    """
    places = np.array([item.T_enu_submap[:3, 3] for item in submaps]).reshape(-1, 3)
    sigmas = [_place_sigma(item) for item in submaps]

    def place_sigma(line: FloatArray) -> float | None:
        return sigmas[int(np.argmin(np.hypot(*(places - line.mean(axis=0))[:, :2].T)))] if sigmas else None

    return {"type": "FeatureCollection", "features": marking_features(markings, kerbs, frame, place_sigma)}


def marking_features(
    markings: Sequence[Marking], kerbs: Sequence[Kerb], frame: MapFrame, place_sigma: Callable[[FloatArray], float | None]
) -> list[dict[str, Any]]:
    """The features of markings, then of kerbs, in `frame`.

    place_sigma : of a line (N, 3), m: that of its place in the plane; None where it is not known
    """

    def placed(line: FloatArray) -> dict[str, float]:
        sigma = place_sigma(line)
        return {} if sigma is None else {"sigma_place_m": round(sigma, MILLIMETRES)}

    features = [_feature(_geometry(one, frame), {**_told(one), **placed(one.line)}) for one in markings]
    return features + [
        _feature(line_geometry(_lonlatheight(one.line, frame)), {**_told_kerb(one), **placed(one.line)}) for one in kerbs
    ]


def _place_sigma(item: PlacedSubmap) -> float:
    """Of a submap's place in the plane, along its worst axis, m: a left perturbation (v, omega) moves it by v + omega x place."""
    J = np.hstack([np.eye(3), -se3.hat(item.T_enu_submap[:3, 3])])
    covariance = J @ item.covariance @ J.T
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance[:2, :2])[-1], 0.0)))


def _geometry(marking: Marking, frame: MapFrame) -> dict[str, Any]:
    """A polygon of what has an area, the middle of lines."""
    if marking.kind in AREAS:
        return {"type": "Polygon", "coordinates": [_lonlatheight(marking.ring, frame)]}
    return line_geometry(_lonlatheight(marking.line, frame))


def _lonlatheight(points: FloatArray, frame: MapFrame) -> list[list[float]]:
    rows = wgs84.lonlatheight_from_enu(points, frame).tolist()
    return [[round(lon, DEGREES), round(lat, DEGREES), round(height, MILLIMETRES)] for lon, lat, height in rows]


def _told(marking: Marking) -> dict[str, Any]:
    """A marking's properties."""
    across, along, width = (round(float(sigma), MILLIMETRES) for sigma in marking.sigma_m)
    covariance = marking.covariance
    told: dict[str, Any] = {
        "kind": marking.kind,
        "width_m": round(marking.width_m, MILLIMETRES),
        "length_m": round(marking.length_m, MILLIMETRES),
        "sigma_m": across,
        "sigma_along_m": along,
        "sigma_width_m": width,
        "covariance_m2": [float(f"{value:.3g}") for value in (covariance[0, 0], covariance[0, 1], covariance[1, 1])],
        "confidence": round(marking.confidence, MILLIMETRES),
        "open": list(marking.open),
    }
    return {**told, "bars": marking.bars, "period_m": round(marking.period_m, MILLIMETRES)} if marking.bars else told


def _told_kerb(kerb: Kerb) -> dict[str, Any]:
    """A kerb's properties: its height at each of its points, and their median."""
    across, high = (round(float(sigma), MILLIMETRES) for sigma in kerb.sigma_m)
    return {
        "kind": "kerb",
        "length_m": round(kerb.length_m, MILLIMETRES),
        "height_m": round(float(np.median(kerb.height_m)), MILLIMETRES),
        "heights_m": [round(float(height), MILLIMETRES) for height in kerb.height_m],
        "sigma_m": across,
        "sigma_height_m": high,
        "confidence": round(kerb.confidence, MILLIMETRES),
    }


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}
