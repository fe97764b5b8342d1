"""File of an odometry result: a zip of npy arrays and a JSON text, of the same bytes whenever it is written.

`numpy.load` opens it too. The version stands in `meta.json`; files of another version are refused.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import PARAMETERS, RightLens
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

ODOMETRY_FILE = "odometry.npz"
FORMAT = "wayloom-odometry"
VERSION = 1
META = "meta.json"
EPOCH = (1980, 1, 1, 0, 0, 0)
GROUPS: dict[str, Any] = {"trajectory": Trajectory, "keyframes": Keyframes, "points": Points}
NOT_OF_THE_DRIVE = ("seconds",)
"""Keys of the report that differ from run to run; they are not stored."""


def save_odometry(result: OdometryResult, path: Path) -> None:
    """Write the result to `path`, whole or not at all. The report's times are left out: they are of the run, not of the drive."""
    arrays = {f"{name}.{field}": getattr(getattr(result, name), field) for name, cls in GROUPS.items() for field in cls.__slots__}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        _add(archive, META, json.dumps(_meta(result), sort_keys=True, indent=1).encode())
        for name, array in sorted(arrays.items()):
            stream = io.BytesIO()
            np.lib.format.write_array(stream, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)
            _add(archive, f"{name}.npy", stream.getvalue())
    write_atomically(path, buffer.getvalue())


def load_odometry(path: Path) -> OdometryResult:
    """Read what save_odometry wrote. Raises InputError that names the file where it is none or of another version."""
    try:
        with zipfile.ZipFile(path) as archive:
            meta = json.loads(archive.read(META))
            if meta.get("format") != FORMAT or meta.get("version") != VERSION:
                raise InputError(
                    f"is {meta.get('format')} version {meta.get('version')}, not {FORMAT} version {VERSION}",
                    file=path, remedy="run the odometry again",
                )  # fmt: skip
            groups = {
                name: cls(**{field: _array(archive, f"{name}.{field}") for field in cls.__slots__}) for name, cls in GROUPS.items()
            }
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, AttributeError) as problem:
        raise InputError(f"is no odometry result ({problem})", file=path, remedy="run the odometry again") from problem
    return OdometryResult(
        rig=StereoRig(PinholeCamera(**meta["camera"]), (meta["t_right_left"][0], meta["t_right_left"][1], meta["t_right_left"][2])),
        disparity_bias_px=meta["disparity_bias_px"],
        row_coefficients=np.array(meta["row_coefficients"], np.float64),
        report=meta["report"],
        lens=RightLens(**{name: float(meta["right_lens"][name]) for name in PARAMETERS}) if "right_lens" in meta else RightLens(),
        **groups,
    )


def _meta(result: OdometryResult) -> dict[str, Any]:
    camera = result.rig.camera
    return {
        "format": FORMAT,
        "version": VERSION,
        "camera": {
            **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
            "width": int(camera.width),
            "height": int(camera.height),
        },
        "t_right_left": [float(t) for t in result.rig.t_right_left],
        "disparity_bias_px": float(result.disparity_bias_px),
        "row_coefficients": [float(c) for c in result.row_coefficients],
        "right_lens": {name: float(getattr(result.lens, name)) for name in PARAMETERS},
        "report": {key: value for key, value in result.report.items() if key not in NOT_OF_THE_DRIVE},
    }


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    """One member with a fixed time and mode, so that equal content gives equal bytes."""
    info = zipfile.ZipInfo(name, EPOCH)
    info.external_attr = 0o644 << 16
    archive.writestr(info, data)


def _array(archive: zipfile.ZipFile, name: str) -> Any:
    return np.lib.format.read_array(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)
