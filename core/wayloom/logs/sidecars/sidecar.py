"""Sidecar metadata `wayloom.json`: rig and vehicle ids, lever arm, IMU extrinsics and topics that a layout has no place for."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from wayloom.config.settings import Settings
from wayloom.errors import LogError
from wayloom.files.text_files import read_text

SIDECAR_NAME = "wayloom.json"
SIMULATED_RIG = "simulated-"
"""How the ids of the simulator's rigs begin: what such a rig recorded is no photograph."""
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e3, le=1e3)]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._-]+$")]
Topic = Annotated[str, Field(min_length=1, max_length=256, pattern=r"^[!-~]+$")]
Row = tuple[Finite, Finite, Finite, Finite]


class Sidecar(Settings):
    """The content of `wayloom.json`; every field may be left out."""

    version: Literal[1] = 1
    rig_id: Identifier | None = None
    vehicle_id: Identifier | None = None
    p_cam_gnss_m: tuple[Finite, Finite, Finite] | None = Field(None, description="the antenna in the left camera's frame, m")
    left_topic: Topic | None = Field(None, description="of a recording with topics: the left camera's images")
    right_topic: Topic | None = Field(None, description="the right camera's images")
    gnss_topic: Topic | None = Field(None, description="the fixes")
    imu_topic: Topic | None = Field(None, description="the IMU's samples")
    T_cam_imu: tuple[Row, Row, Row, Row] | None = Field(None, description="the IMU's frame into the left camera's")


def read_sidecar(folder: Path) -> Sidecar:
    """The sidecar of a log folder; an empty one where there is none. Raises LogError naming the field that is wrong."""
    file = folder / SIDECAR_NAME
    if not file.exists():
        return Sidecar()
    text = read_text(file, remedy="remove it or restore it")
    try:
        sidecar = Sidecar.model_validate_json(text)
    except ValidationError as problem:
        first = problem.errors(include_url=False, include_input=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or None
        what = " ".join(first["msg"].split())
        raise LogError(what, file=file, record=field, remedy="see docs/formats.md, Drive logs") from None
    if sidecar.T_cam_imu is not None:
        check_rigid(np.array(sidecar.T_cam_imu), file)
    return sidecar


def check_rigid(T: NDArray[np.float64], file: Path) -> None:
    """Raises LogError where T (4, 4) is no rigid motion (to 1e-3)."""
    R = T[:3, :3]
    if not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0 and np.allclose(T[3], (0, 0, 0, 1))):
        raise LogError("is no rigid motion", file=file, record="T_cam_imu", remedy="see docs/formats.md, Drive logs")
