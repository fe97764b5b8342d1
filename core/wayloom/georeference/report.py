"""Quality report of a geo-referenced drive: fixes, shifted stretches, receiver, sigmas, and a grade with its reasons."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.georeference.fixes import UsableFixes
from wayloom.georeference.nodes import travelled
from wayloom.georeference.receiver_report import ReceiverFound, receiver_facts, receiver_notes, untold_clock
from wayloom.georeference.rigid import horizontal_spread
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.uncertainty import heading_sigma_rad, position_covariance
from wayloom.logs.types import FixType, GnssTrack
from wayloom.mapping.drive_types import AntennaFixes, DriveSolution, ShiftedFixes
from wayloom.odometry.types import Trajectory

FloatArray = NDArray[np.float64]
GRADES: Final = (("A", 0.1), ("B", 0.3), ("C", 1.0), ("D", 3.0))
"""Grade and the median sigma of the position, m, up to which it is given; E beyond. A doubt costs one grade."""
WORST_GRADE: Final = "E"


@dataclass(frozen=True, slots=True)
class PlacedDrive:
    """T_local_cam (N, 4, 4) in the plane of the drive's own place, covariance (N, 6, 6) of its left perturbation, the odometry's
    track."""

    T_local_cam: FloatArray
    covariance: FloatArray
    trajectory: Trajectory


def georeference_report(
    gnss: GnssTrack,
    usable: UsableFixes,
    fixes: AntennaFixes,
    solution: DriveSolution,
    placed: PlacedDrive,
    receiver: ReceiverFound,
    settings: GeoReferenceSettings,
) -> dict[str, Any]:
    """JSON-ready facts; lengths in m, angles in degrees."""
    residual = solution.residual_enu[solution.inlier]
    variance = np.diagonal(position_covariance(placed.T_local_cam, placed.covariance), axis1=1, axis2=2)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    heading = np.degrees(heading_sigma_rad(placed.covariance))
    extent = float(horizontal_spread(fixes.position_enu[solution.inlier])[0]) if solution.inlier.sum() > 1 else 0.0
    rejected = np.flatnonzero(~solution.inlier)
    doubts = _doubts_of_place(solution)
    if extent < settings.min_baseline_m:
        doubts.insert(
            0, f"the fixes span only {extent:.1f} m: the heading is hardly observed (sigma {np.median(heading):.0f} degrees)"
        )
    return {
        "geo_referenced": True,
        "grade": grade(float(np.median(np.linalg.norm(sigma, axis=1))), len(doubts)),
        "messages": [*doubts, *receiver_notes(receiver), *untold_clock(fixes, solution, sigma, settings)],
        "fixes": {
            "in_log": len(gnss),
            "used": int(solution.inlier.sum()),
            "rejected": len(rejected),
            "unusable": usable.unusable,
        },
        "outliers": [
            {"fix": int(usable.rows[i]), "t_ns": int(gnss.t_ns[usable.rows[i]]), "residual_m": _rounded(solution.residual_enu[i])}
            for i in rejected
        ],
        "shifted": [_shifted(stretch, fixes) for stretch in solution.shifted],
        "height_datums": _height_datums(fixes, solution),
        "scatter_ratio": {FixType(kind).name.lower(): round(ratio, 2) for kind, ratio in solution.noise_ratio.items()},
        **receiver_facts(receiver, int(placed.trajectory.t_ns[0])),
        "residual_rms_m": _rounded(np.sqrt((residual**2).mean(axis=0))),
        "residual_max_m": round(float(np.linalg.norm(residual, axis=1).max()), 4),
        "sigma_enu_m": {"median": _rounded(np.median(sigma, axis=0)), "worst": _rounded(sigma.max(axis=0))},
        "sigma_heading_deg": {"median": round(float(np.median(heading)), 4), "worst": round(float(heading.max()), 4)},
        "extent_m": round(extent, 2),
        "scale": _scale(solution),
        "odometry_m": round(float(travelled(placed.trajectory)[-1]), 2),
        "mapped_m": round(float(np.linalg.norm(np.diff(placed.T_local_cam[:, :3, 3], axis=0), axis=1).sum()), 2),
    }


def grade(sigma_m: float, doubts: int) -> str:
    """A to E: by the median sigma of the position in m, one worse for each doubt."""
    reached = next((row for row, (_, limit) in enumerate(GRADES) if sigma_m <= limit), len(GRADES))
    return "ABCDE"[min(reached + doubts, len(GRADES))]


def _doubts_of_place(solution: DriveSolution) -> list[str]:
    """What makes its place uncertain beyond the stated noise, in words; sigmas were widened for it."""
    doubts = []
    if solution.unconfirmed_m > 0.0:
        doubts.append(
            "the fixes change place once and for all, and nothing says which part is right: "
            f"sigma widened by {solution.unconfirmed_m:.2f} m"
        )
    if solution.unconfirmed_height_m > 0.0:
        doubts.append(
            "the heights of the fixes change once and for all, and nothing says which part is right: "
            f"sigma of the height widened by {solution.unconfirmed_height_m:.2f} m; state the datum that holds, or process "
            "the drive with the fixes of one"
        )
    for kind, ratio in solution.noise_ratio.items():
        name = FixType(kind).name.lower()
        doubts.append(f"{name} fixes scatter {ratio:.1f} times as much as their covariance says: it was widened")
    return doubts


def _shifted(stretch: ShiftedFixes, fixes: AntennaFixes) -> dict[str, Any]:
    """When a stretch of fixes lay apart, and by how much."""
    return {
        "from_s": round(float(fixes.t_s[stretch.first]), 3),
        "to_s": round(float(fixes.t_s[stretch.last]), 3),
        "offset_enu_m": _rounded(stretch.offset_enu),
    }


def _height_datums(fixes: AntennaFixes, solution: DriveSolution) -> list[dict[str, float]]:
    """When fixes had heights of another datum, and by how much it was higher."""
    found = []
    for number, height_m in enumerate(solution.datum_height_m.tolist(), start=1):
        t_s = fixes.t_s[solution.datum == number]
        found.append({"from_s": round(float(t_s[0]), 3), "to_s": round(float(t_s[-1]), 3), "higher_m": round(height_m, 4)})
    return found


def _scale(solution: DriveSolution) -> dict[str, float] | None:
    """Metres of road per metre of odometry, over the stretches of the drive, and the median sigma; None for a single place."""
    if not len(solution.scale):
        return None
    return {
        "mean": round(float(solution.scale.mean()), 5),
        "least": round(float(solution.scale.min()), 5),
        "most": round(float(solution.scale.max()), 5),
        "sigma": round(float(np.median(solution.scale_sigma)), 5),
    }


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(v), 4) for v in values]
