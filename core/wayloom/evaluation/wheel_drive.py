"""Drive of the smartLoc recording: wheel odometry in the place of the cameras' and single-epoch fixes of a consumer receiver.

Reisdorf et al., TU Chemnitz: Berlin, Potsdamer Platz, in street canyons. `fixes.csv` holds t_s, lon_deg, lat_deg, height_m, the
claimed covariance cov_ee_m2 … cov_uu_m2; `odometry.csv` t_s, vx_m_s, wz_rad_s; `truth.csv` t_s and the place.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.evaluation.gnss_drives import MadeLog, odometry_of
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.rigid import R_ENU_LEVELCAM
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.types import FixType, GnssTrack

FloatArray = NDArray[np.float64]
WHEELS = GeoReferenceSettings(position_noise_m=0.02, rotation_noise_deg=0.2, scale_sigma=0.01)
"""Wheels slip, and the zero of a production car's turn rate is off by a milliradian a second: 0.2 degrees a root metre."""


@dataclass(frozen=True, slots=True)
class WheelResult:
    """Horizontal errors m: of the fixes' median, of the drive's median, and the largest ratio of error to stated sigma."""

    fixes_median_m: float
    median_m: float
    sigma_m: float
    ratio: float


def measure_wheel_drive(folder: Path, settings: GeoReferenceSettings = WHEELS) -> WheelResult:
    """Geo-reference the recording. Raises InputError where a table is missing or the drive is not placed."""
    fixes, wheels, truth = (_table(folder / name) for name in ("fixes.csv", "odometry.csv", "truth.csv"))
    place = MapFrame(*(float(truth[name][0]) for name in PLACE_COLUMNS))
    true_enu = wgs84.enu_from_lonlatheight(_places(truth), place)
    odometry = odometry_of(driven(wheels["t_s"], wheels["vx_m_s"], wheels["wz_rad_s"]), wheels["t_s"])
    geo = georeference(MadeLog(_track(fixes), AT_THE_CAR_M), odometry, settings=settings)  # type: ignore[arg-type]
    if geo.frame is None:
        raise InputError("was not placed", file=folder, remedy="look at the report")
    enu = wgs84.enu_from_lonlatheight(wgs84.lonlatheight_from_enu(geo.T_enu_cam[:, :3, 3], geo.frame), place)
    error = np.linalg.norm((enu - _at(wheels["t_s"], truth["t_s"], true_enu))[:, :2], axis=1)
    covariance = position_covariance(geo.T_enu_cam, geo.covariance)
    sigma = np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1])
    of_fixes = wgs84.enu_from_lonlatheight(_places(fixes), place) - _at(fixes["t_s"], truth["t_s"], true_enu)
    raw = float(np.median(np.linalg.norm(of_fixes[:, :2], axis=1)))
    return WheelResult(raw, float(np.median(error)), float(np.median(sigma)), float((error / sigma).max()))


PLACE_COLUMNS = ("lon_deg", "lat_deg", "height_m")
AT_THE_CAR_M = np.array([0.0, -1e-3, 0.0])
"""The truth is the antenna's: the lever arm is known, and it is nothing. (Zeros would be an unknown one.)"""


def driven(t_s: FloatArray, speed_m_s: FloatArray, turn_rad_s: FloatArray) -> FloatArray:
    """(N, 4, 4) T_world_cam of a level camera at t_s (N,), from speed (N,) and turn to the left (N,), each linear between."""
    dt = np.diff(t_s)
    ahead, turn = (0.5 * (rate[1:] + rate[:-1]) * dt for rate in (speed_m_s, turn_rad_s))
    T = np.empty((len(t_s), 4, 4))
    T[0] = se3.from_rotation_translation(R_ENU_LEVELCAM, np.zeros(3))
    for i in range(len(dt)):
        T[i + 1] = T[i] @ se3.exp(np.array([0.0, 0.0, ahead[i], 0.0, -turn[i], 0.0]))
    return T


def _track(fixes: NDArray[np.void]) -> GnssTrack:
    covariance = np.empty((len(fixes), 3, 3))
    for (i, j), name in zip(UPPER, ("ee", "en", "eu", "nn", "nu", "uu"), strict=True):
        covariance[:, i, j] = covariance[:, j, i] = fixes[f"cov_{name}_m2"]
    return GnssTrack(_t_ns(fixes["t_s"]), _places(fixes), covariance, np.full(len(fixes), FixType.SINGLE, np.uint8))


UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _t_ns(t_s: FloatArray) -> NDArray[np.int64]:
    return np.rint(t_s * 1e9).astype(np.int64)


def _places(table: NDArray[np.void]) -> FloatArray:
    return np.column_stack([table[name] for name in PLACE_COLUMNS])


def _at(t_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t_s, known_s, column) for column in values.T])


def _table(path: Path) -> NDArray[np.void]:
    if not path.is_file():
        raise InputError("does not exist", file=path, remedy="give the folder of the smartLoc recording")
    return np.asarray(np.genfromtxt(path, delimiter=",", names=True))
