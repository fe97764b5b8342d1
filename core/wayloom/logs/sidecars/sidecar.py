"""Sidecar metadata `wayloom.json`: rig and vehicle ids, GNSS clock, lever arm, IMU extrinsics, topics: what layouts cannot hold."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from wayloom.config.settings import Settings
from wayloom.errors import LogError
from wayloom.files.text_files import read_text
from wayloom.logs.types import StatedReceiver

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
    p_cam_gnss_sigma_m: float | None = Field(None, ge=1e-4, le=10.0, description="its sigma, each axis, m")
    gnss_time_offset_s: float | None = Field(None, ge=-10.0, le=10.0, description="by how much the fixes' stamps are too late, s")
    gnss_time_offset_sigma_s: float | None = Field(
        None, ge=1e-6, le=10.0, description="its sigma, s; an offset that is left out is 0: 0.001 says that both are on one clock"
    )
    left_topic: Topic | None = Field(None, description="of a recording with topics: the left camera's images")
    right_topic: Topic | None = Field(None, description="the right camera's images")
    gnss_topic: Topic | None = Field(None, description="the fixes")
    imu_topic: Topic | None = Field(None, description="the IMU's samples")
    origin: Annotated[str, Field(max_length=256)] | None = Field(None, description="what a converted log was made of, in words")
    T_cam_imu: tuple[Row, Row, Row, Row] | None = Field(None, description="the IMU's frame into the left camera's")

    @model_validator(mode="after")
    def _says_how_well(self) -> Self:
        if self.gnss_time_offset_s is not None and self.gnss_time_offset_sigma_s is None:
            raise ValueError("gnss_time_offset_s needs gnss_time_offset_sigma_s beside it")
        if self.p_cam_gnss_sigma_m is not None and self.p_cam_gnss_m is None:
            raise ValueError("p_cam_gnss_sigma_m needs p_cam_gnss_m beside it")
        return self

    @property
    def receiver(self) -> StatedReceiver:
        """What is stated of the GNSS receiver."""
        return StatedReceiver(self.gnss_time_offset_s or 0.0, self.gnss_time_offset_sigma_s, self.p_cam_gnss_sigma_m)


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
