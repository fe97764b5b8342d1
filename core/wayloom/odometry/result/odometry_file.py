"""File of an odometry result: a zip of npy arrays and a JSON text, of the same bytes whenever it is written.

`numpy.load` opens it too. The version stands in `meta.json`; files of another version are refused.
"""

import io
import itertools
import json
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.atomic import replacing
from wayloom.files.growing_arrays import forget_pages
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import PARAMETERS, RightLens
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory, no_points

ODOMETRY_FILE = "odometry.npz"
FORMAT = "wayloom-odometry"
VERSION = 2
READABLE = (1, VERSION)
"""Version 1 has no `keyframes.step_covariance`."""
META = "meta.json"
EPOCH = (1980, 1, 1, 0, 0, 0)
GROUPS: dict[str, Any] = {"trajectory": Trajectory, "keyframes": Keyframes, "points": Points}
OBSERVATIONS = ("obs_start", "obs_keyframe", "obs_right")
"""Fields of points that are half of a long drive."""
Wanted: TypeAlias = Literal["all", "points", "way"]
PIECE_BYTES = 1 << 22
NOT_OF_THE_DRIVE = ("seconds",)
"""Keys of the report that differ from run to run; they are not stored."""


def save_odometry(result: OdometryResult, path: Path) -> None:
    """Write the result to `path`, whole or not at all. The report's times are left out: they are of the run, not of the drive.

    Arrays are written in pieces: those that lie in files (`growing_arrays`) are never in memory as a whole.
    """
    arrays = {f"{name}.{field}": getattr(getattr(result, name), field) for name, cls in GROUPS.items() for field in cls.__slots__}
    with replacing(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        meta = json.dumps(_meta(result), sort_keys=True, indent=1).encode()
        _add(archive, META, len(meta), [meta])
        for name, array in sorted(arrays.items()):
            header = _npy_header(array)
            _add(archive, f"{name}.npy", len(header) + array.nbytes, itertools.chain([header], _pieces(array)))


def load_odometry(path: Path, wanted: Wanted = "all") -> OdometryResult:
    """Read what save_odometry wrote, and of a long drive no more than is wanted: points without their observations, or the way
    alone, without a point. Raises InputError that names the file where it is none or of another version."""
    try:
        with zipfile.ZipFile(path) as archive:
            meta = json.loads(archive.read(META))
            if meta.get("format") != FORMAT or meta.get("version") not in READABLE:
                raise InputError(
                    f"is {meta.get('format')} version {meta.get('version')}, not {FORMAT} version {VERSION}",
                    file=path, remedy="run the odometry again",
                )  # fmt: skip
            groups = {name: _group(archive, name, wanted) for name in GROUPS}
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError) as problem:
        raise InputError(f"is no odometry result ({problem})", file=path, remedy="run the odometry again") from problem
    return OdometryResult(
        rig=StereoRig(PinholeCamera(**meta["camera"]), (meta["t_right_left"][0], meta["t_right_left"][1], meta["t_right_left"][2])),
        disparity_bias_px=meta["disparity_bias_px"],
        row_coefficients=np.array(meta["row_coefficients"], np.float64),
        report=meta["report"],
        lens=RightLens(**{name: float(meta["right_lens"][name]) for name in PARAMETERS}) if "right_lens" in meta else RightLens(),
        **groups,
    )


def observations_stored(path: Path) -> int:
    """How many observations the points in a file of `save_odometry` have, none of which is read. Raises InputError."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open("points.obs_keyframe.npy") as member:
            np.lib.format.read_magic(member)
            shape, _, _ = np.lib.format.read_array_header_1_0(member)
            return int(shape[0])
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, IndexError) as problem:
        raise InputError(f"is no odometry result ({problem})", file=path, remedy="run the odometry again") from problem


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


def _add(archive: zipfile.ZipFile, name: str, size: int, pieces: Iterable[bytes]) -> None:
    """One member of `size` bytes with a fixed time and mode, so that equal content gives equal bytes."""
    info = zipfile.ZipInfo(name, EPOCH)
    info.external_attr, info.file_size = 0o644 << 16, size
    with archive.open(info, "w") as member:
        for piece in pieces:
            member.write(piece)


def _npy_header(array: NDArray[Any]) -> bytes:
    """What an npy file of version 1.0 has before the array's bytes, rows first."""
    header = io.BytesIO()
    about = {"descr": np.lib.format.dtype_to_descr(array.dtype), "fortran_order": False, "shape": array.shape}
    np.lib.format.write_array_header_1_0(header, about)
    return header.getvalue()


def _pieces(array: NDArray[Any]) -> Iterator[bytes]:
    """The array's bytes, some rows at a time."""
    rows = max(1, PIECE_BYTES // max(1, array[:1].nbytes))
    for first in range(0, len(array), rows):
        yield np.ascontiguousarray(array[first : first + rows]).tobytes()
        forget_pages(array)


def _group(archive: zipfile.ZipFile, name: str, wanted: Wanted) -> Any:
    cls = GROUPS[name]
    skipped = {"all": (), "points": OBSERVATIONS, "way": Points.__slots__}[wanted] if cls is Points else ()
    read = [field for field in cls.__slots__ if field not in skipped and _has(archive, name, field)]
    arrays = {field: _array(archive, f"{name}.{field}") for field in read}
    return replace(no_points(), **arrays).without_observations() if skipped else cls(**arrays)


def _has(archive: zipfile.ZipFile, group: str, field: str) -> bool:
    """Whether an array is to be read: all are, but what version 1 did not have."""
    return (group, field) != ("keyframes", "step_covariance") or f"{group}.{field}.npy" in archive.namelist()


def _array(archive: zipfile.ZipFile, name: str) -> Any:
    with archive.open(f"{name}.npy") as member:
        return np.lib.format.read_array(member, allow_pickle=False)
