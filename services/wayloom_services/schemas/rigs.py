"""Models of rigs and their receivers. Times are seconds since 1970."""

from typing import Any

from pydantic import BaseModel, Field


class RigDriveOut(BaseModel):
    """A drive that says something of its rig."""

    drive_id: str
    recorded_at: float
    epoch_from: float
    gnss_ratio: float | None = Field(
        description="metres of road per metre of odometry, by GNSS alone; None where it says too little"
    )
    gnss_ratio_sigma: float | None


class RigEpochOut(BaseModel):
    """A stretch of a rig's life in which its drives agree."""

    from_time: float
    drives: int
    chi_square: float | None = Field(
        description="of ten, by which its first drive contradicts the epoch before; None for the first"
    )
    stray: bool = Field(description="one drive that agrees with nothing before and after")


class ReceiverEpochOut(BaseModel):
    """A stretch of a rig's life with one GNSS clock and one place of the antenna, as its drives tell them."""

    from_time: float
    drives: list[str]
    chi_square: float | None = Field(
        description="of four, by which its first drive contradicts the epoch before; None for the first"
    )
    stray: bool = Field(description="one drive that agrees with nothing before and after")
    time_offset_s: float = Field(description="by how much the stamps of fixes are too late")
    sigma_time_offset_s: float = Field(description="where the lever arm is not given")
    p_cam_gnss_m: list[float] = Field(description="the antenna in the left camera's frame, by the drives alone")
    sigma_p_cam_gnss_m: list[float]


class RigVersionOut(BaseModel):
    """A version of a rig's file: what was known, from which drives."""

    version: int
    sha256: str
    epoch_from: float
    drives: list[str]
    reason: str
    facts: dict[str, Any] = Field(description="lens and baseline with sigmas; scale_sigma of its newest drive")
    created_at: float


class RigOut(BaseModel):
    """A rig, all that its drives say of it, and the versions of its file, newest first."""

    id: str
    vehicle_id: str | None
    rig_id: str | None
    created_at: float
    drives: list[RigDriveOut]
    epochs: list[RigEpochOut]
    receivers: list[ReceiverEpochOut]
    versions: list[RigVersionOut]


class RigList(BaseModel):
    """Every rig."""

    rigs: list[RigOut]
