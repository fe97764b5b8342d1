"""File of a drive's places, of the same bytes whenever it is written: a `wayloom.files.blob` (`docs/formats.md`, "Places").

Positions are packed: a feature's place in the image in steps of 1/16 px, its position by that and its inverse depth; the keyframe
of each row by the rows at which the keyframes' begin.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.files.blob import Piece, blob_pieces, decode_blob
from wayloom.geometry.camera import PinholeCamera
from wayloom.places.types import PlaceCloud, PlaceFeatures, Places, PlaceStations

PLACES_FILE: Final = "drive.places"
MAGIC: Final = b"WLPLACES"
VERSION: Final = 1
REMEDY: Final = "run the stage places again while the drive's images are there"
STEPS_PER_PX: Final = 16
DTYPES: Final = {
    "T_world_keyframe": "<f8", "segment": "<i4",
    "feature_start": "<u4", "feature_bits": "|u1", "feature_uv": "<u2", "feature_inverse_depth": "<f4", "feature_sigma": "<f2",
    "cloud_start": "<u4", "cloud_xyz": "<i2", "cloud_label": "|u1", "cloud_sigma": "|u1",
    "station_keyframe": "<u4", "station_grid": "|u1",
}  # fmt: skip


def save_places(places: Places, path: Path) -> None:
    """Write the file, whole or not at all."""
    write_atomically(path, _pieces(places))


def load_places(path: Path) -> Places:
    """Read what `save_places` wrote. Raises InputError that names the file where it is none, damaged or of another version."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=REMEDY) from error
    return decode_places(data, str(path))


def encode_places(places: Places) -> bytes:
    """The bytes of a drive's places."""
    return b"".join(_pieces(places))


def _pieces(places: Places) -> Iterator[Piece]:
    """The file's bytes, in pieces."""
    features, cloud, count = places.features, places.cloud, len(places)
    arrays = {
        "T_world_keyframe": places.T_world_keyframe,
        "segment": places.segment,
        "feature_start": _starts(features.keyframe, count),
        "feature_bits": features.bits,
        "feature_uv": np.rint(STEPS_PER_PX * features.uv),
        "feature_inverse_depth": 1.0 / features.p_cam[:, 2],
        "feature_sigma": features.sigma_m,
        "cloud_start": _starts(cloud.keyframe, count),
        "cloud_xyz": cloud.p_cam,
        "cloud_label": cloud.label,
        "cloud_sigma": cloud.sigma_cm,
        "station_keyframe": places.stations.keyframe,
        "station_grid": places.stations.grid,
    }
    typed = {name: np.asarray(arrays.pop(name)).astype(dtype, copy=False) for name, dtype in DTYPES.items()}
    return blob_pieces(MAGIC, VERSION, {"camera": list(places.camera)}, typed)


def decode_places(data: bytes, name: str = "places") -> Places:
    """The places of these bytes. Raises InputError when they are none, cut off or of another version."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        fx, fy, cx, cy, width, height = header["camera"]
        return _places((fx, fy, cx, cy, int(width), int(height)), arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"holds no places or is damaged ({error})", file=name, remedy=REMEDY) from error


def _places(camera: tuple[float, float, float, float, int, int], a: dict[str, NDArray[Any]]) -> Places:
    uv = a["feature_uv"].astype(np.float64) / STEPS_PER_PX
    p_cam = PinholeCamera(*camera).rays(uv) / a["feature_inverse_depth"].astype(np.float64)[:, None]
    features = PlaceFeatures(
        _keyframes(a["feature_start"]), a["feature_bits"], uv.astype(np.float32), p_cam.astype(np.float32),
        a["feature_sigma"].astype(np.float32),
    )  # fmt: skip
    cloud = PlaceCloud(_keyframes(a["cloud_start"]), a["cloud_xyz"], a["cloud_label"], a["cloud_sigma"])
    if not (len(features) == len(features.bits) and len(cloud) == len(cloud.p_cam)):
        raise ValueError("its tables do not fit each other")
    stations = PlaceStations(a["station_keyframe"].astype(np.int32), a["station_grid"])
    return Places(a["T_world_keyframe"], a["segment"], camera, features, cloud, stations)


def _starts(keyframe: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """(K + 1,) the row at which each keyframe begins."""
    return np.searchsorted(keyframe, np.arange(count + 1))


def _keyframes(start: NDArray[np.uint32]) -> NDArray[np.int32]:
    """The keyframe of each row."""
    return np.repeat(np.arange(len(start) - 1, dtype=np.int32), np.diff(start).astype(np.int64))
