"""Report of the GNSS receiver: what the drive found of its clock and lever arm, against what was known, in words and numbers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.receiver import tells
from wayloom.georeference.receiver_prior import ReceiverPrior
from wayloom.georeference.scale_prior import GOOD_GRADES
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.mapping.drive_types import AntennaFixes, DriveSolution

FloatArray = NDArray[np.float64]
SIGNIFICANT_SIGMA: Final = 4.0
UNTOLD_SHARE: Final = 0.4
"""Of the clock's prior sigma, from which on the drive has told little of it."""
CLOCK_REMEDY: Final = (
    "state the clock in the log (`gnss_time_offset_sigma_s` of wayloom.json) or give the rig's file (--rig): a drive of the "
    "vehicle that turns corners with RTK teaches it"
)


@dataclass(frozen=True, slots=True)
class ReceiverFound:
    """A drive's solution, what was known of its receiver before, the antenna as the log has it, p_cam_gnss (3,) m, and the drift of
    its clock that was put right, s/s."""

    solution: DriveSolution
    prior: ReceiverPrior
    p_cam_gnss: FloatArray
    clock_drift: float = 0.0

    @property
    def time_offset_s(self) -> float:
        """By how much the fixes' stamps in the log are too late."""
        return float(self.prior.mean[0] + self.solution.receiver[0])

    @property
    def lever_correction_m(self) -> FloatArray:
        """(3,) to add to the log's p_cam_gnss."""
        return np.asarray(self.prior.mean[1:] + self.solution.receiver[1:] - self.p_cam_gnss)

    @property
    def sigma(self) -> FloatArray:
        """(4,) s and m."""
        return np.asarray(np.sqrt(np.diag(self.solution.receiver_covariance)))


def receiver_facts(found: ReceiverFound, t_ns: int) -> dict[str, Any]:
    """Time offset, s, and the correction of the lever arm, m, in the camera's frame, with sigmas; who knew them before; and what
    the drive, recorded at t_ns, tells the rig (`wayloom.calibration.receiver.ReceiverEvidence`), None where it tells nothing."""
    prior, told = found.prior, found.solution.told
    evidence = {
        "t_ns": t_ns,
        "information": told.information.tolist(),
        "pull": (told.pull + told.information @ prior.mean).tolist(),
    }
    return {
        "time_offset_s": round(found.time_offset_s, 5),
        "sigma_time_offset_s": round(float(found.sigma[0]), 5),
        "clock_drift_ms_per_s": round(1e3 * found.clock_drift, 4),
        "lever_correction_m": _rounded(found.lever_correction_m),
        "sigma_lever_m": _rounded(found.sigma[1:]),
        "receiver_known_by": [*(["log"] if prior.stated else []), *(["rig"] if prior.learnt is not None else [])],
        "receiver_told": evidence if tells(told.information) else None,
    }


def receiver_by_drive(report: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a drive's report tells the rig of its receiver, None where that is nothing or its place is in doubt."""
    told: dict[str, Any] | None = report.get("receiver_told")
    return told if report.get("grade") in GOOD_GRADES else None


def receiver_notes(found: ReceiverFound) -> list[str]:
    """A clock or a lever arm that the drive found to be off, and knowledge that was denied."""
    sigma, offset_s, lever_m = found.sigma, found.time_offset_s, found.lever_correction_m
    notes = []
    if abs(offset_s) > SIGNIFICANT_SIGMA * sigma[0]:
        side = "late" if offset_s > 0 else "early"
        notes.append(f"the GNSS clock is {1e3 * abs(offset_s):.0f} ms {side} (sigma {1e3 * sigma[0]:.0f} ms)")
    if found.clock_drift:
        notes.append(f"the GNSS clock drifts by {1e3 * found.clock_drift:+.2f} ms a second: its stamps were put right")
    if (np.abs(lever_m) > SIGNIFICANT_SIGMA * sigma[1:]).any():
        right, down, forward = lever_m
        notes.append(f"the antenna is {right:+.2f} m right, {down:+.2f} m down, {forward:+.2f} m forward of where the log says")
    return [*notes, *_denials(found)]


def _denials(found: ReceiverFound) -> list[str]:
    """What was known and is denied: by this drive, or of the log by the rig's earlier ones."""
    prior, (clock, lever) = found.prior, found.solution.overruled
    known = "the rig's earlier drives told" if prior.learnt is not None else "the log states"
    notes = []
    if clock:
        notes.append(
            f"this drive denies the GNSS clock that {known} ({1e3 * prior.mean[0]:.0f} ms late): that was not used; the receiver "
            "was changed or set anew, or its clock is stated wrongly"
        )
    if lever:
        notes.append(f"this drive denies the place of the antenna that {known}: that was not used; measure p_cam_gnss again")
    if prior.overruled[0]:
        notes.append(
            "the rig's earlier drives deny the GNSS clock that the log states: theirs is used; correct the log's statement"
        )
    if prior.overruled[1]:
        notes.append("the rig's earlier drives deny the log's p_cam_gnss: theirs is used; measure it again")
    return notes


def untold_clock(
    fixes: AntennaFixes, solution: DriveSolution, sigma_enu_m: FloatArray, settings: GeoReferenceSettings
) -> list[str]:
    """A word where most of the stated sigma (N, 3) is that of a clock: a straight road at one speed hardly tells it."""
    clock_s = float(np.sqrt(solution.receiver_covariance[0, 0]))
    along_m = clock_s * float(np.median(np.linalg.norm(fixes.v_node_gnss, axis=1)))
    stated_m = float(np.median(np.linalg.norm(sigma_enu_m, axis=1)))
    if clock_s < UNTOLD_SHARE * settings.time_offset_sigma_s or 2.0 * along_m**2 <= stated_m**2:
        return []
    return [
        f"this drive hardly tells how late the GNSS clock is (sigma {1e3 * clock_s:.0f} ms): it may lie {along_m:.2f} m elsewhere "
        f"along the road (1 sigma); {CLOCK_REMEDY}"
    ]


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(v), 4) for v in values]
