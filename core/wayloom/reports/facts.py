"""Content of a drive's report.json: JSON-able numbers and warnings."""

import math
from typing import Any, Final

import numpy as np

import wayloom
from wayloom.config.classes import CLASS_NAMES, VOID
from wayloom.evaluation.trajectory import evaluate, path_length
from wayloom.objects.types import KINDS
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.drive_result import DriveResult
from wayloom.reports import drive_warnings

FORMAT: Final = "wayloom-drive-report"
FORMAT_VERSION: Final = 1


def drive_facts(result: DriveResult) -> dict[str, Any]:
    """The content of report.json. Numbers that are not finite are None."""
    facts: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "wayloom": wayloom.__version__,
        "log": result.log_facts["log"],
        "model": result.model,
        "odometry": odometry_facts(result),
        "georeference": georeference_facts(result),
        "quality": quality_facts(result),
        "cloud": cloud_facts(result),
        "classes": class_counts(result),
        "objects": {kind: sum(one.kind == kind for one in result.objects) for kind in KINDS},
        "stages": {name: {"seconds": time.seconds, "reused": time.reused} for name, time in result.times.items()},
        "warnings": warnings(result),
    }
    errors = truth_errors(result)
    if errors is not None:
        facts["truth"] = errors
    return {name: finite(value) for name, value in facts.items()}


def odometry_facts(result: DriveResult) -> dict[str, Any]:
    """Tracking: frames, segments, keyframes, points, lengths, calibration found on the way, times."""
    odometry = result.odometry
    trajectory = odometry.trajectory
    seconds = result.times["odometry"].seconds
    return {
        "frames": len(trajectory),
        "frames_tracked": int(trajectory.tracked.sum()),
        "segments": len(np.unique(trajectory.segment)),
        "keyframes": len(odometry.keyframes),
        "points": len(result.labels),
        "observations": result.observations,
        "distance_m": path_length(trajectory.T_world_cam[:, :3, 3]),
        "points_per_m": len(result.labels) / max(path_length(trajectory.T_world_cam[:, :3, 3]), 1.0),
        "disparity_bias_px": odometry.disparity_bias_px,
        "row_coefficients_px": [float(c) for c in odometry.row_coefficients],
        "row_offset_in_corner_px": row_offset_in_corner(odometry),
        "ms_per_frame": 1000.0 * seconds / max(len(trajectory), 1),
        "report": odometry.report,
    }


def row_offset_in_corner(odometry: OdometryResult) -> float:
    """The largest |dv| in px that the row coefficients give in the four corners of the image."""
    camera = odometry.rig.camera
    uv = np.array([[u, v] for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)])
    x, y = camera.rays(uv)[:, :2].T
    c0, c1, c2 = odometry.row_coefficients
    return float(np.abs(c0 * (1 + y**2) + c1 * x + c2 * x * y).max())


def georeference_facts(result: DriveResult) -> dict[str, Any]:
    """Map frame of the drive and the accuracy of its pose in it."""
    frame = result.geo.frame
    origin = None if frame is None else {"lon_deg": frame.lon_deg, "lat_deg": frame.lat_deg, "height_m": frame.height_m}
    return {"origin": origin, **result.geo.report}


def quality_facts(result: DriveResult) -> dict[str, Any]:
    """The quality report without its series, which stand in quality.json."""
    quality = result.quality
    drift, loops = quality["drift"], quality["loops"]
    return {
        "grade": quality["grade"],
        "reasons": quality["reasons"],
        "bursts": quality["bursts"],
        "drift": drift and {name: drift[name] for name in ("over_m", "percent", "deg_per_100m")},
        "loops": loops["count"] if loops else 0,
    }


def cloud_facts(result: DriveResult) -> dict[str, Any]:
    """Points in the submaps, and the numbers of points left out by reason."""
    left_out: dict[str, int] = {}
    submaps: list[dict[str, Any]] = []
    for submap in (placed.submap for placed in result.submaps):
        for reason, count in submap.points_left_out.items():
            left_out[reason] = left_out.get(reason, 0) + count
        submaps.append({"digest": submap.digest, "points": len(submap), "length_m": submap.length_m})
    points = sum(one["points"] for one in submaps)
    distance = path_length(result.odometry.trajectory.T_world_cam[:, :3, 3])
    return {
        "frame": "enu" if result.geo.frame is not None else "world",
        "points": points,
        "points_per_m": points / max(distance, 1.0),
        "left_out": left_out,
        "submaps": submaps,
    }


def class_counts(result: DriveResult) -> dict[str, dict[str, int]]:
    """Class name to point counts: host image alone, TCL mono, TCL stereo, and, in stereo, those in the cloud."""
    labels = result.labels
    columns = {"baseline": labels.baseline, "tcl_mono": labels.mono, "tcl_stereo": labels.stereo}
    counts = {name: np.bincount(column, minlength=256) for name, column in columns.items()}
    counts["cloud"] = sum((np.bincount(placed.submap.label, minlength=256) for placed in result.submaps), np.zeros(256, np.int64))
    ids = {name: i for i, name in enumerate(CLASS_NAMES)} | {"void": VOID}
    return {name: {column: int(count[i]) for column, count in counts.items()} for name, i in ids.items()}


def truth_errors(result: DriveResult) -> dict[str, Any] | None:
    """Errors against the log's own truth; None where it has none."""
    truth = result.log.truth
    if truth is None or np.isfinite(truth).all(axis=(1, 2)).sum() < 3:
        return None
    return dict(evaluate(result.odometry.trajectory.T_world_cam, truth).as_json())


def warnings(result: DriveResult) -> list[str]:
    """Warnings about the result, the most serious first."""
    noted = {
        "odometry": _tracking(result.odometry), "georeference": result.geo.report, "log": result.log_facts["log"],
        "network": result.model,
    }  # fmt: skip
    found = [] if any(len(placed.submap) for placed in result.submaps) else ["no point was good enough for the cloud"]
    found += drive_warnings.noted_warnings(noted)
    void = int((result.labels.stereo == VOID).sum())
    if len(result.labels) and void > 0.2 * len(result.labels):
        found.append(f"{100.0 * void / len(result.labels):.0f} % of the points have no label")
    return found


def _tracking(odometry: OdometryResult) -> dict[str, Any]:
    """What `drive_warnings` reads of the odometry."""
    trajectory = odometry.trajectory
    return {
        "frames": len(trajectory), "frames_tracked": int(trajectory.tracked.sum()),
        "segments": len(np.unique(trajectory.segment)), "losses": odometry.report.get("losses", ()),
        **{name: odometry.report[name] for name in drive_warnings.CALIBRATION_FACTS if name in odometry.report},
    }  # fmt: skip


def finite(value: Any) -> Any:
    """The same JSON-able value with numpy numbers as Python's and None for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
