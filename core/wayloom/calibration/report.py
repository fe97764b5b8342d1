"""Report of a calibration, in words and as JSON."""

from dataclasses import asdict
from typing import Any

import numpy as np

from wayloom.calibration.learn import BAD_PX, DRIVE_MORE, Calibration, undetermined
from wayloom.calibration.rig_file import RigFile
from wayloom.geometry.lens import PARAMETERS

POOR_WEIGHT = 0.4
"""A drive whose matches weigh less on average fits badly; a good one has about 0.67."""


def lines(calibration: Calibration) -> list[str]:
    """The result for people."""
    rig = calibration.rig
    out = [f"{len(rig.drives)} drives, {rig.matches} matches, one fits to {rig.noise_px:.2f} px"]
    for name, sigma, known in zip(PARAMETERS, rig.sigma, rig.determined, strict=True):
        out.append(
            f"  {name:12} {getattr(rig.lens, name):+.6f} ± {sigma:.6f}{'' if known else '  (not determined by these drives)'}"
        )
    for drive in calibration.drives:
        out.append(f"  {drive.name}: {drive.points} points, its own disparity bias {drive.disparity_bias_px:+.2f} px")
    out.append(
        f"the right image is off by {calibration.rms_px:.2f} px on average and up to {calibration.worst_px:.2f} px; "
        f"where to, is known to {calibration.unsure_px:.2f} px at worst"
    )
    return out


def warnings(calibration: Calibration) -> list[str]:
    """What speaks against the rig's factory calibration, or against the result."""
    out = list(calibration.doubts)
    out += [f"{name} is left out: {why}" for name, why in calibration.left_out]
    if calibration.worst_px > BAD_PX:
        out.append(f"the calibration of these logs moves pixels of the right image by up to {calibration.worst_px:.1f} px")
    open_ones = undetermined(calibration.rig)
    if open_ones:
        out.append(f"these drives leave {', '.join(open_ones)} undetermined; {DRIVE_MORE}")
    out += [
        f"{drive.name} does not fit the others (its matches weigh {drive.weight:.2f}): is it of the same rig?"
        for drive in calibration.drives
        if drive.weight < POOR_WEIGHT
    ]
    return out


def rig_facts(rig: RigFile) -> dict[str, Any]:
    """JSON-ready: the lens and the baseline with sigmas, and how much they rest on."""
    ratio_sigma = None if rig.covariance is None else rig.baseline_ratio * float(np.sqrt(rig.covariance[-1, -1]))
    return {
        "matches": rig.matches,
        "noise_px": rig.noise_px,
        "right_lens": {
            name: {"value": float(getattr(rig.lens, name)), "sigma": float(sigma), "determined": bool(known)}
            for name, sigma, known in zip(PARAMETERS, rig.sigma, rig.determined, strict=True)
        },
        "baseline_ratio": {"value": rig.baseline_ratio, "sigma": ratio_sigma, "drives_with_gnss": rig.scales},
        "bias_sigma_px": rig.bias_sigma_px,
    }


def facts(calibration: Calibration) -> dict[str, Any]:
    """JSON-ready: the lens with sigmas, the drives, sizes in px, warnings."""
    rig = calibration.rig
    return {
        "rig_id": rig.rig_id,
        "drives": list(rig.drives),
        **rig_facts(rig),
        "used": [asdict(drive) for drive in calibration.drives],
        "worst_px": calibration.worst_px,
        "rms_px": calibration.rms_px,
        "unsure_px": calibration.unsure_px,
        "common_radial": calibration.common_radial,
        "warnings": warnings(calibration),
    }
