"""The GNSS receiver of a vehicle: fixes with the errors that their stated accuracy says."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.geodesy import lonlatheight_from_enu
from wayloom.georeference.types import MapFrame
from wayloom.logs.oxts import UP_FACTOR
from wayloom.logs.oxts_writer import OxtsPacket
from wayloom.logs.types import FixType

F64 = NDArray[np.float64]
SIGMA_M: Final = {FixType.NONE: 50.0, FixType.SINGLE: 1.6, FixType.FLOAT: 0.30, FixType.FIXED: 0.02}
"""Standard deviation of east and of north for each kind of fix; of up it is UP_FACTOR times that."""
SATELLITES: Final = {FixType.NONE: 0, FixType.SINGLE: 7, FixType.FLOAT: 9, FixType.FIXED: 14}
SLOW_SHARE = 0.5
"""Share of the variance that changes slowly (atmosphere, constellation); the rest is new with each fix."""
SLOW_S = 8.0
"""Time after which the slow part has changed by 1 - 1/e."""


@dataclass(frozen=True, slots=True)
class FixPlan:
    """Which kind of fix from when on: (share of the drive, kind), in order; the first begins at 0."""

    steps: tuple[tuple[float, FixType], ...] = ((0.0, FixType.FIXED),)

    def fixes(self, count: int) -> NDArray[np.uint8]:
        """(count,) FixType at evenly spaced times."""
        shares = np.arange(count) / max(count - 1, 1)
        which = np.searchsorted([share for share, _ in self.steps], shares, side="right") - 1
        return np.array([int(fix) for _, fix in self.steps], np.uint8)[which]


def fix_errors(fixes: NDArray[np.uint8], period_s: float, rng: np.random.Generator) -> F64:
    """(M, 3) errors east, north, up, m: normal with the stated sigma, half of the variance slowly changing."""
    kept = np.exp(-period_s / SLOW_S)
    slow, unit = rng.normal(size=3), np.empty((len(fixes), 3))
    for k in range(len(fixes)):
        unit[k] = np.sqrt(SLOW_SHARE) * slow + np.sqrt(1 - SLOW_SHARE) * rng.normal(size=3)
        slow = kept * slow + np.sqrt(1 - kept**2) * rng.normal(size=3)
    sigma = np.array([SIGMA_M[FixType(f)] for f in fixes])
    return np.asarray(unit * sigma[:, None] * (1.0, 1.0, UP_FACTOR))


def receive(
    t_ns: NDArray[np.int64],
    T_enu_cam: F64,
    frame: MapFrame,
    p_cam_gnss: F64,
    plan: FixPlan,
    rng: np.random.Generator,
) -> list[OxtsPacket]:
    """One packet a pose. In an outage the last position is held, the fix says NONE and the accuracy 50 m."""
    antenna = np.array([(T @ np.append(p_cam_gnss, 1.0))[:3] for T in T_enu_cam])
    seconds = (t_ns - t_ns[0]) * 1e-9
    fixes = plan.fixes(len(t_ns))
    measured = antenna + fix_errors(fixes, float(np.diff(seconds).mean()), rng)
    for k in range(1, len(fixes)):
        if fixes[k] == FixType.NONE:
            measured[k] = measured[k - 1]
    places = lonlatheight_from_enu(measured, frame)
    velocity = np.gradient(antenna, seconds, axis=0) + rng.normal(0, 0.05, antenna.shape)
    return [
        OxtsPacket(
            t_ns=int(t_ns[k]),
            lon_lat_height=tuple(places[k].tolist()),
            sigma_m=SIGMA_M[FixType(fixes[k])],
            fix=FixType(fixes[k]),
            roll_pitch_yaw=roll_pitch_yaw(T_enu_cam[k]),
            velocity_enu=tuple(velocity[k].tolist()),
            satellites=SATELLITES[FixType(fixes[k])],
        )
        for k in range(len(t_ns))
    ]


def roll_pitch_yaw(T_enu_cam: F64) -> tuple[float, float, float]:
    """KITTI's angles, rad, of a body (x forward, y left, z up) whose camera looks straight ahead."""
    R = T_enu_cam[:3, :3] @ se3.inverse(BODY_FROM_CAMERA)[:3, :3]
    return float(np.arctan2(R[2, 1], R[2, 2])), float(np.arcsin(np.clip(-R[2, 0], -1, 1))), float(np.arctan2(R[1, 0], R[0, 0]))


BODY_FROM_CAMERA: Final = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
