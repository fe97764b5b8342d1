"""Made straight streets with exact truth: facades on both sides, a road with cross fall, a camera that rolls a little."""

import dataclasses

import numpy as np

from georeference.made_city_drives import antennas, city_path
from georeference.made_gnss_drives import LEVER, PLACE, RIG, MadeDrive, MadeLog, drifting, odometry_of
from wayloom.config.classes import CLASS_ID
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.labelling.types import PointLabels
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.types import FixType, GnssTrack, ImuTrack
from wayloom.odometry.types import Points
from wayloom.simulation.sensors.gnss import SIGMA_M, fix_errors

CROSS_FALL = 0.02
GRAVITY = np.array([0.0, 0.0, 9.81])
IMU_LEAN_RAD = np.radians(0.3)
POINTS_EACH = 40
"""Points that each keyframe hosts."""


def street_drive(seed: int = 0, length_m: float = 1000.0, roll_deg: float = 1.6, gnss: bool = True) -> MadeDrive:
    """RTK along a straight street northwards, a frame a metre; the camera leans by roll_deg, and sways by half a degree besides."""
    rng = np.random.default_rng(seed)
    T = city_path([(0.0, 0.0), (0.0, length_m)])
    sway = np.radians(roll_deg + 0.5 * np.sin(np.arange(len(T)) / 40.0))
    twist = np.zeros((len(T), 6))
    twist[:, 5] = sway
    T = T @ se3.exp(twist)
    t_ns = 1_000_000_000 + np.arange(len(T), dtype=np.int64) * 100_000_000
    drive = MadeDrive(MadeLog(None, LEVER), odometry_of(t_ns, drifting(T, rng, scale_sigma=0.002)), T)
    if not gnss:
        return drive
    kinds = np.full(len(T), FixType.FIXED, np.uint8)
    places = wgs84.lonlatheight_from_enu(antennas(drive) + fix_errors(kinds, 0.1, rng), PLACE)
    covariance = np.tile(np.diag((SIGMA_M[FixType.FIXED] * np.array([1.0, 1.0, UP_FACTOR])) ** 2), (len(T), 1, 1))
    return dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=GnssTrack(t_ns, places, covariance, kinds)))


def with_surroundings(
    drive: MadeDrive, seed: int = 0, facades: bool = True, lean_deg: float = 0.6
) -> tuple[MadeDrive, PointLabels]:
    """Points of facades (each of 15 m leans by lean_deg) about 10 m beside the track, and of a road that falls to the right."""
    rng, keyframes = np.random.default_rng(1000 + seed), drive.odometry.keyframes
    host, place, label = [], [], []
    for row, frame in enumerate(keyframes.frame.tolist()):
        T = drive.T_place_cam[frame]
        ahead = rng.uniform(5.0, 20.0, POINTS_EACH)
        side = rng.choice([-1.0, 1.0], POINTS_EACH)
        height = rng.uniform(-1.5, 5.0, POINTS_EACH)
        house = np.floor((T[1, 3] + ahead) / 15.0) * side
        of_house = np.array([_of_house(int(k), seed) for k in house])
        right = side * (9.5 + 0.7 * of_house[:, 0]) + np.radians(lean_deg) * of_house[:, 1] * height
        kind = np.full(POINTS_EACH, CLASS_ID["building"], np.uint8)
        road = np.arange(POINTS_EACH) % 3 == 0
        right[road] = rng.uniform(-4.0, 4.0, road.sum())
        height[road] = -1.65 - CROSS_FALL * right[road]
        kind[road] = CLASS_ID["road"]
        keep = road | facades
        host.append(np.full(keep.sum(), row))
        place.append((T[:3, 3] + np.column_stack([right, ahead, height]))[keep])
        label.append(kind[keep])
    hosts, points_place, labels = np.concatenate(host), np.concatenate(place), np.concatenate(label)
    T_cam_place = se3.inverse(drive.T_place_cam[keyframes.frame[hosts]])
    p_cam = np.einsum("nij,nj->ni", T_cam_place[:, :3, :3], points_place) + T_cam_place[:, :3, 3]
    p_cam *= 1.0 + 0.01 * rng.normal(size=(len(p_cam), 1))
    return _hosting(drive, hosts, p_cam), _labelled(labels)


def _of_house(house: int, seed: int) -> np.ndarray:
    """(2,) how far it stands back and how it leans, in sigmas."""
    return np.random.default_rng([seed, abs(house), int(house > 0)]).normal(size=2)


def _hosting(drive: MadeDrive, host: np.ndarray, p_cam: np.ndarray) -> MadeDrive:
    camera, n = RIG.camera, len(host)
    uv = p_cam[:, :2] / p_cam[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    none = np.zeros(0, bool)
    points = Points(
        host.astype(np.int32), uv.astype(np.float32), (1.0 / p_cam[:, 2]).astype(np.float32),
        ((0.01 / p_cam[:, 2]) ** 2).astype(np.float32), np.zeros(n, np.uint8), np.zeros(n + 1, np.int64),
        np.zeros(0, np.int32), none, np.zeros(n, bool),
    )  # fmt: skip
    return dataclasses.replace(drive, odometry=dataclasses.replace(drive.odometry, points=points))


def _labelled(label: np.ndarray) -> PointLabels:
    start = np.arange(len(label) + 1, dtype=np.int64)
    return PointLabels(label, label, label, start, label, np.ones(len(label), np.float32))


def with_imu(drive: MadeDrive, seed: int = 0) -> MadeDrive:
    """An IMU at 50 Hz at the camera, its axes x ahead, y left, z up, which leans by IMU_LEAN_RAD and is noisy."""
    rng = np.random.default_rng(seed)
    t_ns, T = drive.odometry.trajectory.t_ns, drive.T_place_cam
    R_cam_imu = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    t_s = 1e-9 * t_ns
    acceleration = np.gradient(np.gradient(T[:, :3, 3], t_s, axis=0), t_s, axis=0)
    force = np.einsum("nji,nj->ni", T[:, :3, :3] @ R_cam_imu, acceleration + GRAVITY)
    times = np.arange(t_ns[0], t_ns[-1], 20_000_000)
    sampled = np.stack([np.interp(times, t_ns, axis) for axis in force.T], axis=1) + 0.05 * rng.normal(size=(len(times), 3))
    sampled[:, 1] += 9.81 * IMU_LEAN_RAD
    T_cam_imu = se3.from_rotation_translation(R_cam_imu, np.zeros(3))
    log = dataclasses.replace(drive.log, imu=ImuTrack(times, sampled, np.zeros_like(sampled)), T_cam_imu=T_cam_imu)
    return dataclasses.replace(drive, log=log)
