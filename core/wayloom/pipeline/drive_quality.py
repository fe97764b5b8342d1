"""Quality report of a drive: grade with reasons, GNSS residuals, drift, covariance along the track, loops; JSON-ready.

Series are thinned for people; every number is kept in `georeference.npz`. Places and directions are of the drive's own plane
(`pipeline.plane`), so up is up however far the map's origin lies.
"""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.georeference.nodes import travelled
from wayloom.georeference.rigid import mean_motion
from wayloom.georeference.types import FixResiduals, GeoReference
from wayloom.georeference.uncertainty import heading_sigma_rad, moved_covariance, position_covariance
from wayloom.loops.types import LoopClosures, no_loops
from wayloom.odometry.types import OdometryResult, Trajectory
from wayloom.pipeline.plane import T_plane_enu

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
QUALITY_FILE: Final = "quality.json"
FORMAT: Final = "wayloom-drive-quality"
FORMAT_VERSION: Final = 1
SAME_M: Final = 1e-3
"""Where no fix and no loop moves it, the result is the odometry but for rounding and its levelling."""
MOST: Final = 1500
"""Entries of a line, whatever the drive's length: more than a picture has pixels."""
MOST_FIXES: Final = 800
"""Dots, which weigh more in a picture than a line's corners: as many of fixes that were used, and of those that were not."""
DRIFT_M: Final = 100.0
ANCHOR_M: Final = 50.0
"""Road at the start over which the odometry is laid upon the result, so that no single pose's noise turns all of it."""


def drive_quality(odometry: OdometryResult, geo: GeoReference, loops: LoopClosures | None = None) -> dict[str, Any]:
    """Content of quality.json; lengths in m, angles in degrees, times in s from the first frame. None for what does not apply."""
    trajectory, report = odometry.trajectory, geo.report
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "placed": geo.frame is not None,
        "grade": report.get("grade"),
        "sound": is_sound(report, trajectory),
        "reasons": reasons(report, trajectory),
        "fixes": _fixes(geo.fixes, trajectory),
        "bursts": [stretch for stretch in report.get("shifted", ()) if stretch["to_s"] > stretch["from_s"]],  # else an outlier
        "receiver": _receiver(report),
        "scale": report.get("scale"),
        "track": _track(trajectory, geo),
        "drift": _drift(trajectory, geo),
        "loops": _loops(odometry, geo, loops or no_loops()),
    }


def is_sound(report: dict[str, Any], trajectory: Trajectory) -> bool:
    """Whether at most the drive's place is in doubt, and not its odometry.

    Pieces between losses of the track are put together by fixes: without any, nothing says where they lie against each other.
    """
    return bool(report.get("geo_referenced")) or _pieces(trajectory) == 1


def reasons(report: dict[str, Any], trajectory: Trajectory) -> list[str]:
    """Why the geo-reference gave its grade, in words: the sigma that it starts from, then all that speaks against the place."""
    found = [str(message) for message in report.get("messages", ())]
    if not report.get("geo_referenced"):
        lost = _pieces(trajectory) - 1
        broken = [f"the track was lost {lost} times, and no GNSS says how the pieces lie against each other"] if lost else []
        return [*(found or ["no GNSS: the drive has no place on Earth"]), *broken]
    sigma_m = float(np.linalg.norm(report["sigma_enu_m"]["median"]))
    worst_m = float(np.linalg.norm(report["sigma_enu_m"]["worst"]))
    return [f"sigma of the position {sigma_m:.2f} m in the median, {worst_m:.2f} m at worst", *found]


def _pieces(trajectory: Trajectory) -> int:
    return len(np.unique(trajectory.segment[trajectory.tracked]))


def write_quality(file: Path, quality: dict[str, Any]) -> None:
    """Write quality.json. Equal content is equal bytes."""
    file.write_text(json.dumps(quality, allow_nan=False, separators=(",", ":")) + "\n", encoding="utf-8")


def read_quality(file: Path) -> dict[str, Any]:
    """The content of quality.json. Raises InputError where it is none."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"is no quality report ({error})", file=file, remedy="run the geo-reference stage again") from error
    if not isinstance(content, dict) or (content.get("format"), content.get("format_version")) != (FORMAT, FORMAT_VERSION):
        raise InputError(f"is no {FORMAT} of version {FORMAT_VERSION}", file=file, remedy="run the geo-reference stage again")
    return content


def thinned(count: int, most: int = MOST) -> IntArray:
    """At most so many of count rows, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)) if count else np.zeros(0, np.int64)


def _fixes(fixes: FixResiduals, trajectory: Trajectory) -> dict[str, Any] | None:
    """The residuals; of those that were not used as many as of the others, so that no short burst is thinned away."""
    if not len(fixes):
        return None
    parts = [np.flatnonzero(chosen) for chosen in (fixes.used, ~fixes.used)]
    rows = np.sort(np.concatenate([part[thinned(len(part), MOST_FIXES)] for part in parts]))
    return {
        "count": len(fixes),
        "t_s": _rounded((fixes.t_ns[rows] - trajectory.t_ns[0]) * 1e-9, 3),
        "residual_enu_m": _rounded(fixes.residual_enu[rows].T, 4),
        "sigma_enu_m": _rounded(fixes.sigma_enu[rows].T, 4),
        "used": fixes.used[rows].tolist(),
    }


def _receiver(report: dict[str, Any]) -> dict[str, Any] | None:
    names = ("time_offset_s", "sigma_time_offset_s", "lever_correction_m", "sigma_lever_m")
    return {name: report[name] for name in names} if all(name in report for name in names) else None


def _track(trajectory: Trajectory, geo: GeoReference) -> dict[str, Any]:
    """The track, and its one-sigma bounds where there are any."""
    rows = thinned(len(trajectory))
    T_plane = T_plane_enu(geo)
    place = se3.transform(T_plane, geo.T_enu_cam[rows, :3, 3])
    track: dict[str, Any] = {
        "t_s": _rounded((trajectory.t_ns[rows] - trajectory.t_ns[0]) * 1e-9, 3),
        "road_m": _rounded(travelled(trajectory)[rows], 2),
        "plane_m": _rounded(place.T, 2),
        "sigma": None,
    }
    if np.isfinite(geo.covariance[rows]).all():  # without GNSS they are relative to the first frame
        covariance = moved_covariance(T_plane, geo.covariance[rows])
        variance = np.diagonal(position_covariance(T_plane @ geo.T_enu_cam[rows], covariance), axis1=1, axis2=2)
        sigma = np.sqrt(np.maximum(variance, 0.0))
        track["sigma"] = {
            "enu_m": _rounded(sigma.T, 4),
            "heading_deg": _rounded(np.degrees(heading_sigma_rad(covariance)), 4),
        }
    return track


def _drift(trajectory: Trajectory, geo: GeoReference) -> dict[str, Any] | None:
    """The odometry alone against the result: how far it is off along the road, and how fast that grows. None where both are one."""
    road = travelled(trajectory)
    apart = _apart(trajectory, geo, road)
    if geo.frame is None and float(apart.max(initial=0.0)) < SAME_M:
        return None
    rows = thinned(len(trajectory))
    length_m = min(DRIFT_M, 0.5 * float(road[-1]))
    translation, rotation = _growth(trajectory, geo, road, length_m)
    if not len(translation):
        return None
    return {
        "road_m": _rounded(road[rows], 2),
        "odometry_m": _rounded(apart[rows], 3),
        "over_m": round(length_m, 1),
        "percent": {"median": _number(np.median(translation)), "worst": _number(translation.max())},
        "deg_per_100m": {"median": _number(np.median(rotation)), "worst": _number(rotation.max())},
    }


def _apart(trajectory: Trajectory, geo: GeoReference, road: FloatArray) -> FloatArray:
    """(N,) m between the result and the odometry, laid upon it at the start."""
    start = road <= ANCHOR_M
    T_enu_world = mean_motion(geo.T_enu_cam[start] @ se3.inverse(trajectory.T_world_cam[start]))
    difference = se3.transform(T_enu_world, trajectory.T_world_cam[:, :3, 3]) - geo.T_enu_cam[:, :3, 3]
    return np.asarray(np.linalg.norm(difference, axis=1))


def _growth(trajectory: Trajectory, geo: GeoReference, road: FloatArray, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Translation, percent, and rotation, degrees per 100 m, by which odometry and result differ over stretches of length_m."""
    if length_m <= 0.0:
        return np.zeros(0), np.zeros(0)
    starts = np.unique(np.searchsorted(road, np.arange(0.0, road[-1] - length_m, 0.1 * length_m)))
    ends = np.searchsorted(road, road[starts] + length_m)
    kept = ends < len(road)
    starts, ends = starts[kept], ends[kept]
    by_odometry = se3.inverse(trajectory.T_world_cam[starts]) @ trajectory.T_world_cam[ends]
    by_result = se3.inverse(geo.T_enu_cam[starts]) @ geo.T_enu_cam[ends]
    difference = se3.inverse(by_result) @ by_odometry
    driven = road[ends] - road[starts]
    cosine = 0.5 * (np.trace(difference[:, :3, :3], axis1=1, axis2=2) - 1.0)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return 100.0 * np.linalg.norm(difference[:, :3, 3], axis=1) / driven, 100.0 * angle / driven


def _loops(odometry: OdometryResult, geo: GeoReference, loops: LoopClosures) -> dict[str, Any] | None:
    """Where the drive closes upon itself: the two places of each closure, (4, L) m: x, y and x, y. None where it does not."""
    if not len(loops):
        return None
    place = se3.transform(T_plane_enu(geo), geo.T_enu_cam[odometry.keyframes.frame, :3, 3])[:, :2]
    rows = thinned(len(loops))
    ends = np.column_stack([place[loops.first[rows]], place[loops.second[rows]]])
    kept = geo.report.get("loops", {})
    refused = sum(visit["closures"] for visit in kept.get("refused", ()))
    return {"count": len(loops), "used": kept.get("used"), "refused": refused, "ends_m": _rounded(ends.T, 2)}


def _rounded(values: FloatArray, digits: int) -> Any:
    """A list, or a list of lists, of rounded numbers."""
    return np.round(np.asarray(values, np.float64), digits).tolist()


def _number(value: Any) -> float:
    return round(float(value), 4)
