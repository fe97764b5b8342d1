"""A hand-held pair of real lenses in EuRoC's format: it stands, is lifted, goes sideways and back, turns quickly, and leans.

Nothing of the odometry may take the pair for a car's: motion along the view, the ground below, gravity along the image's columns.
"""

import functools
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_street import render
from numpy.typing import NDArray

from logs.euroc.euroc_kit import radtan_pair, rays_of_pixels
from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.geometry.rectification import LensCamera
from wayloom.logs.drive_writer import ImageEncoding, SensorExtrinsics
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.registry import open_log
from wayloom.logs.types import ImuTrack, StereoFrame
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings

F64 = NDArray[np.float64]
FRAMES, RATE_HZ, IMU_HZ, SHARE = 60, 20.0, 200.0, 0.3
START_NS = 1_403_636_579_763_555_584
GRAVITY = np.array([0.0, 9.81, 0.0])
"""m/s^2 in the world of the made street, whose y axis points down."""
DIFFERENCE_S = 1e-3


class Lens:
    """What `render` asks of a camera, through a real lens."""

    def __init__(self, lens: LensCamera) -> None:
        self.width, self.height, self._rays = lens.camera.width, lens.camera.height, rays_of_pixels(lens)

    def rays(self, uv: F64) -> F64:
        """Of all pixels."""
        assert len(uv) == len(self._rays)
        return self._rays


def body_pose(t_s: F64, lean_rad: float) -> F64:
    """T_world_left (M, 4, 4): half a second of rest, then all six axes, at up to 40 degrees and 0.9 m a second."""
    t = np.maximum(t_s - 0.5, 0.0)
    ease = t**2 / (t**2 + 0.3)
    turn = ease[:, None] * np.stack([0.12 * np.sin(1.7 * t), 0.45 * np.sin(1.5 * t), 0.15 * np.sin(1.2 * t)], axis=1)
    place = ease[:, None] * np.stack([0.5 * np.sin(1.1 * t), -0.35 * np.sin(0.9 * t), -0.4 * np.sin(0.8 * t)], axis=1)
    T = se3.exp(np.concatenate([np.zeros_like(turn), turn], axis=1)) @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, lean_rad]))
    T[:, :3, 3] = place + np.array([0.0, 0.0, 39.0])  # six metres before the wall at the street's end
    return np.asarray(T)


def imu_track(lean_rad: float, T_left_body: F64) -> ImuTrack:
    """What an ideal IMU in the body's origin feels."""
    t = np.arange(0.0, FRAMES / RATE_HZ, 1.0 / IMU_HZ)
    before, now, after = (body_pose(t + k * DIFFERENCE_S, lean_rad) @ T_left_body for k in (-1, 0, 1))
    acceleration = (after[:, :3, 3] - 2.0 * now[:, :3, 3] + before[:, :3, 3]) / DIFFERENCE_S**2
    force = np.einsum("mji,mj->mi", now[:, :3, :3], acceleration - GRAVITY)
    change = np.einsum("mji,mjk->mik", before[:, :3, :3], after[:, :3, :3])
    skew = change - change.swapaxes(1, 2)
    rate = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1) / (4.0 * DIFFERENCE_S)
    return ImuTrack(START_NS + np.rint(1e9 * t).astype(np.int64), force, rate)


@functools.cache
def handheld(lean_rad: float) -> tuple[tempfile.TemporaryDirectory[str], Path]:
    """The drive, with EuRoC's own lenses, mounting and baseline of 11 cm."""
    folder = tempfile.TemporaryDirectory()
    path, cameras = Path(folder.name) / "V9_02_made", radtan_pair(SHARE)
    T_left_body = se3.inverse(cameras[0].T_body_cam)
    lenses = [Lens(camera.lens) for camera in cameras]
    rig = StereoRig(cameras[0].lens.camera, (-0.11, 0.0, 0.0))
    sensors = SensorExtrinsics(T_cam_imu=T_left_body)
    with EurocWriter(path, rig, extrinsics=sensors, encoding=ImageEncoding(colour=False)) as drive:
        drive.cameras = cameras
        for index, T in enumerate(body_pose(np.arange(FRAMES) / RATE_HZ, lean_rad)):
            places = [T @ T_left_body @ camera.T_body_cam for camera in cameras]
            left, right = (np.rint(render(at, lens)[0]).astype(np.uint8) for at, lens in zip(places, lenses, strict=True))
            drive.add(StereoFrame(index, START_NS + 50_000_000 * index, left, right), T)
        drive.set_imu(imu_track(lean_rad, T_left_body))
    return folder, path


@pytest.mark.parametrize(("lean_deg", "imu"), [(0.0, True), (90.0, True), (0.0, False)])
def test_a_handheld_pair_is_tracked_whole_whatever_way_it_moves_and_leans(lean_deg: float, imu: bool) -> None:
    log = open_log(handheld(np.radians(lean_deg))[1])
    assert log.imu is not None
    assert log.truth is not None
    trajectory = track(log if imu else replace(log, imu=None), OdometrySettings()).trajectory
    assert trajectory.tracked.all()
    assert trajectory.segment.max() == 0
    T, truth = (se3.inverse(poses[0]) @ poses for poses in (trajectory.T_world_cam, log.truth))
    road_m = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    off = np.linalg.norm(T[:, :3, 3] - truth[:, :3, 3], axis=1)
    turned = [np.degrees(np.linalg.norm(se3.log(se3.inverse(a) @ b)[3:])) for a, b in zip(T, truth, strict=True)]
    assert off.max() < 0.03 * road_m  # measured: 1.4 %, and 0.14 degrees
    assert max(turned) < 0.3
    assert off[:10].max() < 1e-3
