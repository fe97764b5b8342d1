"""Geo-referenced drive: poses in the map's frame, with their covariance."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FixResiduals:
    """Every fix that was looked at, against the result, in the tangent plane of the drive's own place.

    t_ns          (M,) int64, increasing
    residual_enu  (M, 3) m: fix minus antenna
    sigma_enu     (M, 3) m, of the fix as the receiver states it
    used          (M,) whether the place rests on it
    """

    t_ns: NDArray[np.int64]
    residual_enu: FloatArray
    sigma_enu: FloatArray
    used: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_ns)


def no_residuals() -> FixResiduals:
    """Those of a drive without usable fixes."""
    return FixResiduals(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.bool_))


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a map asks of a drive.

    frame    the map's frame; None takes the one of the place (`wayloom.geodesy.map_frame.map_frame_for`)
    anchors  (A,) frames of the log at keyframes, increasing: of each its covariance with the next is wanted
    """

    frame: MapFrame | None = None
    anchors: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True, slots=True)
class Anchors:
    """Frames of a drive whose joint covariance is known, each with the next.

    frame      (A,) increasing
    cross      (A - 1, 6, 6) covariance of the left perturbations of a frame's T_enu_cam (rows) and of the next one's (columns)
    connected  (A - 1,) whether the odometry tracked all the way to the next
    """

    frame: NDArray[np.int64]
    cross: FloatArray
    connected: NDArray[np.bool_]


def no_anchors() -> Anchors:
    """None asked for."""
    return Anchors(np.zeros(0, np.int64), np.zeros((0, 6, 6)), np.zeros(0, np.bool_))


@dataclass(frozen=True, slots=True)
class GeoReference:
    """A drive in its map's frame, or, where it has no GNSS, in its own.

    frame        the map frame, None without GNSS: then `enu` below is the drive's own level frame, in which its first camera stands
                 at the origin and looks along the second axis (`wayloom.mapping.own_frame`)
    T_enu_cam    (N, 4, 4) for every frame of the log
    covariance   (N, 6, 6) of the left perturbation (v, omega) of T_enu_cam, m^2 and rad^2; without GNSS relative to the first
    report       JSON-ready facts: fixes used and rejected, residuals, honest sigma
    fixes        residuals of the fixes, none without GNSS
    anchors      what is known of some frames together: what joins the drive's submaps
    """

    frame: MapFrame | None
    T_enu_cam: FloatArray
    covariance: FloatArray
    report: dict[str, Any] = field(default_factory=dict)
    fixes: FixResiduals = field(default_factory=no_residuals)
    anchors: Anchors = field(default_factory=no_anchors)
