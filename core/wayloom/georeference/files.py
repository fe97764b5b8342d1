"""Geo-reference file `georeference.npz`: poses, covariances, frame, residuals, anchors, report. Equal results give equal bytes."""

import io
import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.types import Anchors, FixResiduals, GeoReference

GEOREFERENCE_FILE = "georeference.npz"
FORMAT = "wayloom-georeference"
VERSION = 3


def save_georeference(geo: GeoReference, path: Path) -> None:
    """Write atomically. (A zip of NumPy carries no time, so equal results are equal bytes.)"""
    frame = None if geo.frame is None else [geo.frame.lon_deg, geo.frame.lat_deg, geo.frame.height_m]
    header = {"format": FORMAT, "version": VERSION, "frame": frame, "report": geo.report}
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(header, sort_keys=True).encode(), np.uint8)
    fixes = {f"fix_{field.name}": getattr(geo.fixes, field.name) for field in fields(FixResiduals)}
    anchors = {f"anchor_{field.name}": getattr(geo.anchors, field.name) for field in fields(Anchors)}
    np.savez(buffer, header=text, T_enu_cam=geo.T_enu_cam, covariance=geo.covariance, **fixes, **anchors)
    write_atomically(path, buffer.getvalue())


def load_georeference(path: Path) -> GeoReference:
    """Read a geo-reference. Raises InputError that names the file when it is missing, damaged or of another version."""
    remedy = "run the geo-reference stage again"
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
            _check_version(header, path, remedy)
            T_enu_cam, covariance = file["T_enu_cam"], file["covariance"]
            fixes = FixResiduals(*(file[f"fix_{field.name}"] for field in fields(FixResiduals)))
            anchors = Anchors(*(file[f"anchor_{field.name}"] for field in fields(Anchors)))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"is no geo-reference ({error})", file=path, remedy=remedy) from error
    frame = None if header["frame"] is None else MapFrame(*header["frame"])
    return GeoReference(frame, T_enu_cam, covariance, header["report"], fixes, anchors)


def _check_version(header: dict[str, Any], path: Path, remedy: str) -> None:
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise InputError(f"has version {header.get('version')}, this program reads {VERSION}", file=path, remedy=remedy)
