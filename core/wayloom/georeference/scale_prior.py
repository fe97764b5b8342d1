"""Scale of the odometry between rig and GNSS: the prior by what is known of the rig, and what the fixes alone say of it."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from wayloom.georeference.settings import GeoReferenceSettings

GOOD_GRADES: Final = ("A", "B")
"""Of drives whose fixes may speak of their rig."""
TELLING: Final = 0.5
"""Posterior over prior sigma above which the fixes say too little."""


def scale_prior(odometry_report: Mapping[str, Any], settings: GeoReferenceSettings) -> float:
    """Sigma of the odometry's scale, as a share: of a rig that is known from earlier drives its own, else that of the settings.

    odometry_report : with `scale` (`wayloom.calibration.scale.scale_facts`) where it was told, and `rig` where a file was used
    """
    stated = odometry_report.get("scale")
    if odometry_report.get("rig") is None or stated is None:
        return settings.scale_sigma
    return min(settings.scale_sigma, float(np.hypot(stated["sigma"], settings.local_scale_sigma)))


def scale_by_gnss(
    report: Mapping[str, Any], odometry_report: Mapping[str, Any], settings: GeoReferenceSettings
) -> dict[str, Any] | None:
    """What the fixes alone say of a drive's scale, JSON-ready (`wayloom.calibration.baseline.ScaleByGnss`), or None.

    The graph's scale p of sigma s_p holds the prior 1 of sigma s_0: the fixes say 1 + (p - 1) s^2/s_p^2, 1/s^2 = 1/s_p^2 - 1/s_0^2.
    """
    found, own, prior = report.get("scale"), odometry_report.get("scale"), scale_prior(odometry_report, settings)
    if report.get("grade") not in GOOD_GRADES or found is None or own is None or not found["sigma"] < TELLING * prior:
        return None
    variance = 1.0 / (1.0 / max(found["sigma"], 1e-5) ** 2 - 1.0 / prior**2)
    ratio = 1.0 + (found["mean"] - 1.0) * variance / max(found["sigma"], 1e-5) ** 2
    kept = {name: own[name] for name in ("by_lens", "own_sigma", "lens", "baseline_ratio")}
    return {"ratio": ratio, "sigma": float(np.sqrt(variance)), **kept}
