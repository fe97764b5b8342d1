"""The file of a drive's calibration observations: a zip of npy arrays and a JSON text, the same bytes whenever it is written."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.rig.calibration_observations import TARGETS, CalibrationObservations

FORMAT: Final = "wayloom-evidence"
VERSION: Final = 1
META: Final = "meta.json"
EPOCH: Final = (1980, 1, 1, 0, 0, 0)
REMEDY: Final = "make it again: wayloom odometry LOG --out FILE --evidence FILE"
LARGEST_BYTES: Final = 64 << 20
"""Of one array when unpacked: a file that claims more is damaged."""
MEMBERS: Final = {"group": "snippet"}
"""Arrays whose name in the file is an older one."""
ARRAYS: Final[dict[str, tuple[str, tuple[str | int, ...]]]] = {
    "host_frame": ("<i4", ("S",)),
    "target_frame": ("<i4", ("S", TARGETS)),
    "T_target_host": ("<f8", ("S", TARGETS, 4, 4)),
    "group": ("<i4", ("P",)),
    "uv_host": ("<i4", ("P", 2)),
    "uv_right": ("<f4", ("P", 2)),
    "uv_left_target": ("<f4", ("P", TARGETS, 2)),
    "uv_right_target": ("<f4", ("P", TARGETS, 2)),
}


def save_observations(observations: CalibrationObservations, file: Path) -> None:
    """Write `file`, whole or not at all."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, META, json.dumps(_meta(observations), sort_keys=True, indent=1).encode())
        for name, (dtype, _) in ARRAYS.items():
            stream = io.BytesIO()
            array = np.ascontiguousarray(getattr(observations, name), np.dtype(dtype))
            np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)
            _add(archive, f"{MEMBERS.get(name, name)}.npy", stream.getvalue())
    write_atomically(file, buffer.getvalue())


def load_observations(file: Path) -> CalibrationObservations:
    """Read what save_observations wrote. Raises InputError naming the file where it is none, of another version or damaged."""
    return _load(file, file)


def observations_from_bytes(content: bytes, file: Path) -> CalibrationObservations:
    """As `load_observations`, of the bytes of a file that errors name."""
    return _load(io.BytesIO(content), file)


def _load(source: Path | io.BytesIO, file: Path) -> CalibrationObservations:
    try:
        with zipfile.ZipFile(source) as archive:
            meta = json.loads(archive.read(META))
            if meta.get("format") != FORMAT or meta.get("version") != VERSION:
                what = f"is {meta.get('format')} version {meta.get('version')}, not {FORMAT} version {VERSION}"
                raise InputError(what, file=file, remedy=REMEDY)
            arrays = {name: _array(archive, name) for name in ARRAYS}
            camera, t = meta["camera"], meta["t_right_left_m"]
            numbers = {name: float(camera[name]) for name in ("fx", "fy", "cx", "cy")}
            pinhole = PinholeCamera(**numbers, width=int(camera["width"]), height=int(camera["height"]))
            rig = StereoRig(pinhole, (float(t[0]), float(t[1]), float(t[2])))
            observations = CalibrationObservations(str(meta["name"]), meta["rig_id"], rig, **arrays)
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError, IndexError) as problem:
        raise InputError(f"holds no calibration observations ({problem})", file=file, remedy=REMEDY) from None
    _check(observations, file)
    return observations


def is_observations_file(path: Path) -> bool:
    """Whether a path looks like an observations file: any drive log is a folder, or a file that is no zip with this content."""
    if not path.is_file() or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return META in archive.namelist() and "uv_right_target.npy" in archive.namelist()


def _meta(observations: CalibrationObservations) -> dict[str, Any]:
    camera = observations.rig.camera
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": observations.name,
        "rig_id": observations.rig_id,
        "camera": {
            **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
            "width": int(camera.width),
            "height": int(camera.height),
        },
        "t_right_left_m": [float(t) for t in observations.rig.t_right_left],
    }


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    """One member with a fixed time and mode, so that equal content gives equal bytes."""
    info = zipfile.ZipInfo(name, EPOCH)
    info.external_attr, info.compress_type = 0o644 << 16, zipfile.ZIP_DEFLATED
    archive.writestr(info, data)


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    member = archive.getinfo(f"{MEMBERS.get(name, name)}.npy")
    if member.file_size > LARGEST_BYTES:
        raise ValueError(f"{name} claims {member.file_size} bytes")
    array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(archive.read(member)), allow_pickle=False)
    if array.dtype != np.dtype(ARRAYS[name][0]):
        raise ValueError(f"{name} is of {array.dtype}")
    return array


def _check(observations: CalibrationObservations, file: Path) -> None:
    """Raises InputError where shapes do not fit each other or values cannot be."""
    sizes: dict[str | int, int] = {"S": observations.groups, "P": len(observations)}
    for name, (_, shape) in ARRAYS.items():
        wanted = tuple(sizes.get(size, size) for size in shape)
        found = getattr(observations, name).shape
        if found != wanted:
            raise InputError(f"{name} has the shape {found}, not {wanted}", file=file, remedy=REMEDY)
    group, camera = observations.group, observations.rig.camera
    sound = (np.diff(group) >= 0).all() and ((group >= 0) & (group < max(observations.groups, 1))).all()
    inside = ((observations.uv_host >= 0) & (observations.uv_host < (camera.width, camera.height))).all()
    if not (sound and inside and np.isfinite(observations.uv_right).all() and np.isfinite(observations.T_target_host).all()):
        raise InputError("holds values that cannot be", file=file, remedy=REMEDY)
    if not (observations.rig.baseline_m > 0 and camera.fx > 0 and camera.fy > 0):
        raise InputError("has an impossible calibration", file=file, remedy=REMEDY)
