"""Errors of roll, pitch and height, with the witnesses of up and without, beside what is stated.

python benchmarks/gravity.py [LOG PROCESSED …] [--clips DATA PROCESSED_A PROCESSED_B] [--seeds 6] [--write]

Made straight kilometres with RTK, from fresh seeds on (100, 101, …). LOG is a simulated drive whose GNSS has fixed ambiguities,
PROCESSED what `wayloom process` made of it. Up of the simulated truth, which stands in its first camera's frame, is by its rigid
alignment to the fixes. DATA holds the recordings of docs/results.md. With --write the tables that were made go to
docs/benchmarks/gravity.md, between their marks.
"""

import argparse
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pages import DOCS, put_between_marks

sys.path.pop(0)  # this folder: its georeference.py hides the package
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from georeference.made_streets import street_drive, with_surroundings
from wayloom.config.classes import CLASS_ID
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.fixes import interpolate
from wayloom.georeference.gravity.witnesses import seen_up
from wayloom.georeference.rigid import align_rigid
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.labelling.files import load_labels
from wayloom.labelling.types import PointLabels
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog, FixType
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
NEAR_M, ROUNDS, FIX_SIGMA_M = 15.0, 20, 0.03
"""Sidewalk points count up to there from their camera; rounds of re-weighting, and the sigma in it, of truth to fixes."""
FIRST_SEED, FAULTY_A = 100, 16
"""Seeds below were used while the noise model was chosen; frames of clip A whose INS is known to be wrong."""
PAGE = DOCS / "benchmarks" / "gravity.md"
ROLL_HEAD = """| drive | GNSS | labels | roll rms ° | stated ° | sidewalk height rms m | worst 5 % m |
| --- | --- | --- | --- | --- | --- | --- |"""
HEIGHT_HEAD = """| drive | road m | odometry: end m | rms m | graph: end m | stated m | rms m | roll (stated) ° | pitch (stated) ° |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |"""
CLIP_HEAD = """| clip | GNSS | labels | roll ° | stated ° | pitch ° | stated ° | pitch, INS turned ° |
| --- | --- | --- | --- | --- | --- | --- | --- |"""
ROLL_PITCH = [0, 2]


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


def placed(log: DriveLog, odometry: OdometryResult, labels: PointLabels | None, gnss: bool, imu: bool) -> GeoReference:
    """Geo-referenced with a part of what the log has."""
    names = ("gnss", "p_cam_gnss", "receiver", "name", "rig", "t_ns", "T_cam_imu", "imu")
    plain = types.SimpleNamespace(**{name: getattr(log, name) for name in names})
    plain.gnss, plain.imu = log.gnss if gnss else None, log.imu if imu else None
    return with_up(plain, odometry, labels)


def with_up(log: Any, odometry: OdometryResult, labels: PointLabels | None) -> GeoReference:
    """Geo-referenced by what is seen of up, too."""
    settings = GeoReferenceSettings()
    return georeference(log, odometry, settings=settings, up=seen_up(log, odometry, labels, settings))


def stated_deg(geo: GeoReference, axis: int) -> float:
    """Median sigma of the turn about an axis of the camera, degrees: 2 roll, 0 pitch."""
    along = geo.T_enu_cam[:, :3, axis]
    return float(np.median(np.degrees(np.sqrt(np.einsum("ni,nij,nj->n", along, geo.covariance[:, 3:, 3:], along)))))


def kilometres(seeds: int) -> str:
    """The table of made straight kilometres, and the NEES of up with its band; each drive counts once, by its mean."""
    lines, nees = ["| seed | roll rms ° | stated ° | NEES of up / 2 |", "| --- | --- | --- | --- |"], []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        drive, labels = with_surroundings(street_drive(seed), seed)
        geo = with_up(drive.log, drive.odometry, labels)
        assert geo.frame is not None
        error = (geo.T_enu_cam[:, 2, :3] - drive.truth_in(geo.frame)[:, 2, :3])[:, ROLL_PITCH]
        axes = geo.T_enu_cam[:, :3, [2, 0]] * [1.0, -1.0]  # up moves to the right by a turn about ahead, ahead by one about left
        covariance = np.swapaxes(axes, 1, 2) @ geo.covariance[:, 3:, 3:] @ axes
        nees.append(float(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]).mean()))
        lines.append(f"| {seed} | {np.degrees(rms(error[:, 0])):.2f} | {stated_deg(geo, 2):.2f} | {nees[-1] / 2:.2f} |")
        print(lines[-1], flush=True)
    low, high = chi2.ppf([0.025, 0.975], 2 * seeds) / (2 * seeds)
    return "\n".join(lines) + f"\n\nMean NEES / 2: {np.mean(nees) / 2:.2f}; 95 % of honest ones lie in {low:.2f} to {high:.2f}."


def height_row(name: str, log: DriveLog, odometry: OdometryResult, labels: PointLabels) -> str:
    """Of a drive without GNSS: heights by the odometry, whose first pose is true, and by the graph with all its witnesses."""
    T_true, place = true_poses(log)
    alone = T_true[0] @ se3.inverse(odometry.trajectory.T_world_cam[0]) @ odometry.trajectory.T_world_cam
    geo = placed(log, odometry, labels, gnss=False, imu=True)
    T = in_place(geo, T_true, place)
    apart = [(X - T_true)[:, 2, 3] for X in (alone, T)]
    stated = np.sqrt(position_covariance(geo.T_enu_cam, geo.covariance)[-1, 2, 2])
    up = np.degrees(T[:, 2, :3] - T_true[:, 2, :3])
    road = np.linalg.norm(np.diff(T_true[:, :3, 3], axis=0), axis=1).sum()
    return (
        f"| {name} | {road:.0f} | {apart[0][-1]:.2f} | {rms(apart[0]):.2f} "
        f"| {apart[1][-1]:.2f} | {stated:.2f} | {rms(apart[1]):.2f} "
        f"| {rms(up[:, 0]):.2f} ({stated_deg(geo, 2):.2f}) | {rms(up[:, 2]):.2f} ({stated_deg(geo, 0):.2f}) |"
    )


def clip_rows(name: str, log: DriveLog, packets: Path, made: Path, first: int) -> list[str]:
    """Of a recording: up against its INS from frame `first` on, by its calibration files, and by the rotation between INS and
    camera on which odometry and INS agree over ten frames (Kabsch); that needs a bend."""
    odometry, labels = stages(made)
    files = sorted(packets.glob("*.txt"))[: len(log)]
    yaw_pitch_roll = np.array([np.loadtxt(file)[5:2:-1] for file in files])
    assert log.T_cam_imu is not None
    R_ins = Rotation.from_euler("ZYX", yaw_pitch_roll).as_matrix() @ log.T_cam_imu[:3, :3].T
    turns = [
        Rotation.from_matrix(np.swapaxes(R[:-10], 1, 2) @ R[10:]).as_rotvec()
        for R in (odometry.trajectory.T_world_cam[:, :3, :3], R_ins)
    ]
    turned = R_ins @ Rotation.align_vectors(*turns)[0].as_matrix().T
    lines = []
    for gnss in (True, False):
        for used in (None, labels):
            geo = placed(log, odometry, used, gnss, imu=False)
            up = geo.T_enu_cam[:, 2, :3]
            if geo.frame is not None:
                here = MapFrame(*wgs84.lonlatheight_from_enu(geo.T_enu_cam[:1, :3, 3], geo.frame)[0])
                up = (wgs84.T_enu_enu(here, geo.frame) @ geo.T_enu_cam)[:, 2, :3]
            error, other = (np.degrees(up - R[:, 2])[first:] for R in (R_ins, turned))
            lines.append(
                f"| {name} | {'INS' if gnss else 'none'} | {'yes' if used else 'no'} | {rms(error[:, 0]):.2f} "
                f"| {stated_deg(geo, 2):.2f} | {rms(error[:, 2]):.2f} | {stated_deg(geo, 0):.2f} | {rms(other[:, 2]):.2f} |"
            )
    return lines


def stages(made: Path) -> tuple[OdometryResult, PointLabels]:
    """What `wayloom process` left in a folder."""
    odometry = load_odometry(made / "stages" / "odometry" / "odometry.npz")
    return odometry, load_labels(made / "stages" / "labelling" / "labels.npz")


def row(name: str, log: DriveLog, odometry: OdometryResult, labels: PointLabels, gnss: bool, used: bool) -> str:
    """Of the table: one drive, geo-referenced with the labels used or not, without IMU."""
    T_true, place = true_poses(log)
    geo = placed(log, odometry, labels if used else None, gnss, imu=False)
    T = in_place(geo, T_true, place)
    error = np.degrees(T[:, 2, 0] - T_true[:, 2, 0])
    height = np.abs(sidewalk_errors(odometry, labels, T, T_true))
    return (
        f"| {name} | {'RTK' if gnss else 'none'} | {'yes' if used else 'no'} | {rms(error):.2f} | {stated_deg(geo, 2):.2f} "
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


def tables(options: argparse.Namespace) -> dict[str, str]:
    """By the name of its marks on the page."""
    found: dict[str, str] = {}
    if options.seeds:
        found["kilometres"] = kilometres(options.seeds)
    rolls, heights = [ROLL_HEAD], [HEIGHT_HEAD]
    for path, made in zip(options.paths[::2], options.paths[1::2], strict=True):
        log, name = open_log(path), f"{path.parent.name} {path.name}"
        odometry, labels = stages(made)
        rolls += [row(name, log, odometry, labels, gnss, used) for gnss in (True, False) for used in (False, True)]
        heights.append(height_row(name, log, odometry, labels))
        print("\n".join([*rolls[-4:], heights[-1]]), flush=True)
    if options.paths:
        found |= {"rolls": "\n".join(rolls), "heights": "\n".join(heights)}
    if options.clips:
        data, made_a, made_b = options.clips
        oxts = data / "kitti_oxts" / "2011_10_03" / "2011_10_03_drive_0027_sync"
        clip_b = data / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync"
        clip_a = open_log(data / "kitti_odometry" / "sequences" / "00", gnss=oxts)
        lines = clip_rows("A", clip_a, oxts / "oxts" / "data", made_a, FAULTY_A)
        lines += clip_rows("B", open_log(clip_b), clip_b / "oxts" / "data", made_b, 0)
        found["clips"] = "\n".join([CLIP_HEAD, *lines])
        print(found["clips"], flush=True)
    return found


def main() -> None:
    """Print the tables, write them where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="*")
    parser.add_argument("--clips", type=Path, nargs=3)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    for name, text in tables(options).items():
        if options.write:
            put_between_marks(PAGE, name, text)


if __name__ == "__main__":
    main()
