"""The real recordings, as they lie on disk."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.oxts import ins_trajectory

pytestmark = pytest.mark.real_data


def test_clip_a_is_a_grey_kitti_odometry_log(clip_a: Path) -> None:
    log = open_log(clip_a)
    assert (log.format, len(log), log.colour) == ("kitti-odometry", 201, False)
    assert (log.rig.camera.fx, log.rig.camera.width, log.rig.camera.height) == (718.856, 1241, 376)
    assert log.rig.t_right_left == pytest.approx((-386.1448 / 718.856, 0.0, 0.0))
    assert log.t_ns[:3].tolist() == [0, 103_735_900, 207_338_100]
    assert log.truth is not None
    assert np.linalg.norm(np.diff(log.truth[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(145.4, abs=0.1)
    expected = cv2.imread(str(clip_a / "image_1/000003.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(log.frame(3).right, expected)


def test_clip_b_is_a_colour_kitti_raw_log_of_jpegs(clip_b: Path) -> None:
    log = open_log(clip_b)
    assert (log.format, len(log), log.colour) == ("kitti-raw", 154, True)
    assert log.rig.t_right_left == pytest.approx((-0.53271, 0.00275, -0.0000160), abs=1e-5)
    assert log.t_ns[0] % 10**9 == 345_808_896
    assert log.gnss is not None
    assert np.bincount(log.gnss.fix_type, minlength=4).tolist() == [0, 53, 101, 0]
    assert set(log.missing) == {"IMU"}
    frame = log.frame(10)
    assert frame.left.shape == (375, 1242, 3)
    assert frame.left[:100, :, 2].mean() != frame.left[:100, :, 0].mean()


def test_the_velocities_of_clip_b_integrate_to_its_length(clip_b: Path) -> None:
    ins = ins_trajectory(clip_b)
    assert ins.distance_m == pytest.approx(71.34, abs=0.01)
    said = np.linalg.norm(np.diff(ins.T_enu_imu[:, :3, 3], axis=0), axis=1).sum()
    assert said == pytest.approx(69.43, abs=0.05)


@pytest.mark.parametrize(
    ("drive", "length_m"),
    [
        ("2011_09_26/2011_09_26_drive_0086_sync", 268.8),
        ("2011_09_26/2011_09_26_drive_0087_sync", 286.9),
        ("2011_09_26/2011_09_26_drive_0106_sync", 114.0),
        ("2011_09_30/2011_09_30_drive_0027_sync", 692.2),
        ("2011_10_03/2011_10_03_drive_0027_sync", 3720.0),
    ],
)
def test_positions_and_velocities_of_a_gnss_log_agree(data_dir: Path, drive: str, length_m: float) -> None:
    ins = ins_trajectory(data_dir / "kitti_oxts" / drive)
    assert ins.distance_m == pytest.approx(length_m, rel=1e-3)
    assert np.linalg.norm(np.diff(ins.T_enu_imu[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(ins.distance_m, rel=5e-3)
    forward = ins.T_enu_imu[:-1, :3, 0]
    step = np.diff(ins.integrated_enu, axis=0)
    moving = np.linalg.norm(step, axis=1) > 0.3
    along = (forward * step).sum(axis=1)[moving] / np.linalg.norm(step, axis=1)[moving]
    assert np.median(along) > 0.999, "the unit's x axis points where the car drives"


def test_velocities_lead_where_positions_go(data_dir: Path) -> None:
    ins = ins_trajectory(data_dir / "kitti_oxts/2011_09_26/2011_09_26_drive_0087_sync")
    five_s = 50
    by_position = (ins.T_enu_imu[five_s:, :2, 3] - ins.T_enu_imu[:-five_s, :2, 3])[::five_s]
    by_velocity = (ins.integrated_enu[five_s:, :2] - ins.integrated_enu[:-five_s, :2])[::five_s]
    way = np.linalg.norm(by_velocity, axis=1)
    apart = np.linalg.norm(by_position - by_velocity, axis=1)[way > 10] / way[way > 10]
    assert np.median(apart) < 0.015, "leftward velocity, which these recordings count to the right, would make it 0.03"
