"""Errors of roll and of the height of sidewalks, with the witnesses of up and without, beside what is stated.

python benchmarks/gravity.py LOG PROCESSED [LOG PROCESSED …]

LOG is a simulated drive whose GNSS has fixed ambiguities, PROCESSED what `wayloom process` made of it. Up of the simulated truth,
which stands in its first camera's frame, is by its rigid alignment to the fixes. The IMU is not used.
"""

import argparse
import types
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.fixes import interpolate
from wayloom.georeference.rigid import align_rigid
from wayloom.georeference.types import GeoReference
from wayloom.labelling.files import load_labels
from wayloom.labelling.types import PointLabels
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog, FixType
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
NEAR_M, ROUNDS, FIX_SIGMA_M = 15.0, 20, 0.03
"""Sidewalk points count up to there from their camera; rounds of re-weighting, and the sigma in it, of truth to fixes."""
HEAD = """| drive | GNSS | labels | roll rms ° | stated ° | sidewalk height rms m | worst 5 % m |
| --- | --- | --- | --- | --- | --- | --- |"""


def true_poses(log: DriveLog) -> tuple[FloatArray, MapFrame]:
    """T_place_cam (N, 4, 4) of the frames, in the tangent plane of a fix."""
    gnss, truth = log.gnss, log.truth
    assert gnss is not None
    assert truth is not None
    fixed = gnss.fix_type == FixType.FIXED
    t_ns = np.clip(gnss.t_ns[fixed], log.t_ns[0], log.t_ns[-1])
    before = np.clip(np.searchsorted(log.t_ns, t_ns, side="right") - 1, 0, len(log) - 2)
    share = (t_ns - log.t_ns[before]) / (log.t_ns[before + 1] - log.t_ns[before])
    T = interpolate(truth[before], truth[before + 1], share)
    antenna = T[:, :3, :3] @ log.p_cam_gnss + T[:, :3, 3]
    place = MapFrame(*gnss.lon_lat_height[fixed][0])
    enu = wgs84.enu_from_lonlatheight(gnss.lon_lat_height[fixed], place)
    weight = np.ones(len(enu))
    for _ in range(ROUNDS):
        T_place_truth = align_rigid(antenna, enu, weight)
        apart = np.linalg.norm(enu - se3.transform(T_place_truth, antenna), axis=1)
        weight = 1.0 / (FIX_SIGMA_M**2 + apart**2)
    return T_place_truth @ truth, place


def in_place(geo: GeoReference, T_place_cam: FloatArray, place: MapFrame) -> FloatArray:
    """T (N, 4, 4) in the plane of the truth; a drive in a frame of its own is moved to the true place and heading of its start."""
    if geo.frame is not None:
        return np.asarray(wgs84.T_enu_enu(place, geo.frame) @ geo.T_enu_cam)
    true, own = T_place_cam[0], geo.T_enu_cam[0]
    yaw = np.arctan2(true[1, 2], true[0, 2]) - np.arctan2(own[1, 2], own[0, 2])
    T = se3.exp(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, yaw]]))[0]
    T[:3, 3] = true[:3, 3] - T[:3, :3] @ own[:3, 3]
    return np.asarray(T @ geo.T_enu_cam)


def row(name: str, log: DriveLog, odometry: OdometryResult, labels: PointLabels, gnss: bool, used: bool) -> str:
    """Of the table: one drive, geo-referenced with the labels used or not."""
    T_true, place = true_poses(log)
    plain = types.SimpleNamespace(
        **{name: getattr(log, name) for name in ("gnss", "p_cam_gnss", "receiver", "name", "rig", "t_ns", "T_cam_imu")}
    )
    plain.imu, plain.gnss = None, log.gnss if gnss else None
    geo = georeference(plain, odometry, labels=labels if used else None)  # type: ignore[arg-type]
    T = in_place(geo, T_true, place)
    error = np.degrees(T[:, 2, 0] - T_true[:, 2, 0])
    ahead = geo.T_enu_cam[:, :3, 2]
    stated = np.degrees(np.sqrt(np.einsum("ni,nij,nj->n", ahead, geo.covariance[:, 3:, 3:], ahead)))
    height = np.abs(sidewalk_errors(odometry, labels, T, T_true))
    return (
        f"| {name} | {'RTK' if gnss else 'none'} | {'yes' if used else 'no'} | {rms(error):.2f} | {np.median(stated):.2f} "
        f"| {rms(height):.3f} | {np.percentile(height, 95):.3f} |"
    )


def sidewalk_errors(odometry: OdometryResult, labels: PointLabels, T: FloatArray, T_true: FloatArray) -> FloatArray:
    """(n,) m: how much higher points of sidewalks lie by poses T than by T_true (N, 4, 4), less the same of their cameras."""
    points, keyframes = odometry.points, odometry.keyframes
    rows = np.flatnonzero((labels.stereo == CLASS_ID["sidewalk"]) & (points.inverse_depth > 1.0 / NEAR_M))
    world = odometry.points_world()[rows]
    host = keyframes.frame[points.host[rows]]
    T_cam_world = se3.inverse(keyframes.T_world_cam[points.host[rows]])
    p_cam = np.einsum("nij,nj->ni", T_cam_world[:, :3, :3], world) + T_cam_world[:, :3, 3]
    lift = T[host, 2, :3] - T_true[host, 2, :3]
    return np.asarray(np.einsum("ni,ni->n", lift, p_cam))


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((values**2).mean()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="+")
    paths = parser.parse_args().paths
    print(HEAD)
    for path, made in zip(paths[::2], paths[1::2], strict=True):
        log = open_log(path)
        odometry = load_odometry(made / "stages" / "odometry" / "odometry.npz")
        labels = load_labels(made / "stages" / "labelling" / "labels.npz")
        for gnss in (True, False):
            for used in (False, True):
                print(row(f"{path.parent.name} {path.name}", log, odometry, labels, gnss, used), flush=True)


if __name__ == "__main__":
    main()
