"""A log that is converted and converted back is the same log."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from logs.euroc.euroc_kit import radtan_pair, write_euroc
from logs.made_drives import (
    FRAMES,
    RIG,
    T_CAM_IMU,
    WRITERS,
    made_frames,
    made_imu,
    made_poses,
    sample_files,
    track_file,
    write_drive,
)
from wayloom.errors import ConfigError, LogError
from wayloom.logs.conversion import TARGETS, convert_log
from wayloom.logs.drive_writer import ImageEncoding, SensorExtrinsics
from wayloom.logs.kitti.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.gnss_csv import write_gnss_csv
from wayloom.logs.types import DriveLog, GnssTrack, StatedReceiver

targets = pytest.mark.parametrize("target", list(TARGETS))


def made_fixes() -> GnssTrack:
    """A fix of each type, with a whole covariance."""
    t_ns = np.array([frame.t_ns + 7 for frame in made_frames(FRAMES, colour=False)])
    place = np.array([8.4, 49.0, 115.0]) + 1e-5 * np.random.default_rng(3).normal(size=(FRAMES, 3))
    kinds = np.array([3, 2, 1, 0, 3, 1], np.uint8)
    spread = np.array([[1.0, 0.2, 0.1], [0.2, 1.5, -0.3], [0.1, -0.3, 4.0]])
    sigma_m = np.array([3.0, 2.0, 0.5, 0.03])[kinds]
    return GnssTrack(t_ns, place, sigma_m[:, None, None] ** 2 * spread, kinds)


def full_drive(folder: Path, *, colour: bool = True, jpeg_quality: int | None = None) -> Path:
    """A KITTI drive with everything that a log can hold."""
    sensors = SensorExtrinsics(np.array([0.1, -0.9, -0.4]), T_CAM_IMU, receiver=StatedReceiver(0.02, 1e-3, 0.01))
    encoding = ImageEncoding(colour=colour, jpeg_quality=jpeg_quality)
    with KittiOdometryWriter(
        folder / "07", RIG, rig_id="rig-7", vehicle_id="car-7", extrinsics=sensors, encoding=encoding
    ) as drive:
        for frame, T in zip(made_frames(FRAMES, colour), made_poses(FRAMES), strict=True):
            drive.add(frame, T)
    write_gnss_csv(folder / "07" / "gnss.csv", made_fixes())
    sample_files(folder / "07")
    return folder / "07"


def assert_same(log: DriveLog, before: DriveLog) -> None:
    """All that the odometry and the geo-reference see is bit for bit the same."""
    for name in ("rig_id", "vehicle_id", "colour", "receiver"):
        assert getattr(log, name) == getattr(before, name)
    assert log.rig == before.rig
    np.testing.assert_array_equal(log.t_ns, before.t_ns)
    for got, frame in zip(log.frames(), before.frames(), strict=True):
        np.testing.assert_array_equal(got.left, frame.left)
        np.testing.assert_array_equal(got.right, frame.right)
        assert got.exposure_s == frame.exposure_s
        for side in (False, True):
            mine, other = (getattr(drive, "grey_side")(got.index, side) for drive in (log, before))  # noqa: B009
            np.testing.assert_array_equal(mine, other)
    for name in ("gnss", "imu"):
        mine, other = getattr(log, name), getattr(before, name)
        assert (mine is None) == (other is None)
        for field in () if other is None else other.__slots__:
            np.testing.assert_array_equal(getattr(mine, field), getattr(other, field))
    np.testing.assert_array_equal(log.p_cam_gnss, before.p_cam_gnss)
    np.testing.assert_array_equal(log.T_cam_imu, before.T_cam_imu)


@targets
@pytest.mark.parametrize("colour", [True, False])
def test_a_log_comes_back_bit_for_bit(tmp_path: Path, target: str, colour: bool) -> None:
    before = open_log(full_drive(tmp_path, colour=colour))
    there = convert_log(before, tmp_path / "there", target)
    assert (there.frames, there.copied, there.left_out) == (FRAMES, FRAMES, ())
    log = open_log(there.path)
    assert_same(log, before)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth, before.truth, atol=1e-12)
    back = convert_log(log, tmp_path / "back", "kitti")
    assert_same(open_log(back.path), before)
    for name in ("image_2/000003.png", "image_3/000000.png") if colour else ("image_0/000003.png",):
        assert (back.path / name).read_bytes() == (before.root / name).read_bytes()


@targets
def test_jpeg_images_are_not_encoded_again(tmp_path: Path, target: str) -> None:
    before = open_log(full_drive(tmp_path, jpeg_quality=80))
    done = convert_log(before, tmp_path / "there", target)
    assert done.copied == FRAMES
    assert_same(open_log(done.path), before)


@pytest.mark.parametrize("source", list(WRITERS))
@targets
def test_every_format_converts_into_every_target(tmp_path: Path, source: str, target: str) -> None:
    before = open_log(write_drive(tmp_path / "here", source))
    log = open_log(convert_log(before, tmp_path / "there", target).path)
    np.testing.assert_array_equal(log.t_ns, before.t_ns)
    np.testing.assert_array_equal(log.frame(2).right, before.frame(2).right)
    assert log.gnss is not None
    assert before.gnss is not None
    np.testing.assert_array_equal(log.gnss.lon_lat_height, before.gnss.lon_lat_height)
    np.testing.assert_allclose(log.gnss.covariance_enu, before.gnss.covariance_enu, rtol=1e-15)
    np.testing.assert_array_equal(log.gnss.fix_type, before.gnss.fix_type)


@targets
def test_images_of_a_real_lens_are_written_rectified_and_the_log_says_where_it_came_from(tmp_path: Path, target: str) -> None:
    before = open_log(write_euroc(tmp_path / "V9_01_made", radtan_pair()))
    done = convert_log(before, tmp_path / "there", target)
    assert done.copied == 0
    log = open_log(done.path)
    assert log.rig == before.rig
    np.testing.assert_array_equal(log.frame(1).left, before.frame(1).left)
    np.testing.assert_array_equal(log.T_cam_imu, before.T_cam_imu)
    assert log.imu is not None
    np.testing.assert_array_equal(log.imu.specific_force, made_imu().specific_force)
    assert not getattr(log, "rectifies", True)
    assert "euroc 'V9_01_made', rectified; wayloom" in (done.path / "wayloom.json").read_text()


@targets
def test_frames_without_truth_stay_without_or_the_poses_are_left_out_and_named(tmp_path: Path, target: str) -> None:
    before = open_log(full_drive(tmp_path))
    assert before.truth is not None
    before.truth[2] = np.nan
    done = convert_log(before, tmp_path / "there", target)
    log = open_log(done.path)
    if target == "kitti":
        assert log.truth is None
        assert "true poses" in done.left_out[0]
    elif target == "mcap":
        assert log.truth is not None
        assert np.isfinite(log.truth).all(axis=(1, 2)).tolist() == [True, True, False, True, True, True]
        assert done.left_out == ()
    else:
        lines = (done.path / "mav0/state_groundtruth_estimate0/data.csv").read_text().splitlines()
        stamps = [int(line.split(",")[0]) for line in lines if not line.startswith("#")]
        assert stamps == np.delete(before.t_ns, 2).tolist()
        assert done.left_out == ()


def test_images_of_two_kinds_become_one_kind_or_are_refused(tmp_path: Path) -> None:
    drive = full_drive(tmp_path)
    picture = cv2.imread(str(drive / "image_2/000003.png"))
    (drive / "image_2/000003.png").unlink()
    cv2.imwrite(str(drive / "image_2/000003.jpg"), picture)
    before = open_log(drive)
    done = convert_log(before, tmp_path / "there", "euroc")
    assert done.copied == FRAMES - 1
    np.testing.assert_array_equal(open_log(done.path).frame(3).left, before.frame(3).left)
    photos = full_drive(tmp_path / "photos", jpeg_quality=90)
    (photos / "image_3/000004.jpg").unlink()
    cv2.imwrite(str(photos / "image_3/000004.png"), picture)
    with pytest.raises(LogError, match="frame 4: is no JPEG"):
        convert_log(open_log(photos), tmp_path / "other", "mcap")
    assert not (tmp_path / "other").exists()


def test_fixes_whose_type_the_target_cannot_tell_are_counted(tmp_path: Path) -> None:
    drive = full_drive(tmp_path)
    track_file(drive / "gnss.csv")  # of integer fixes with a sigma of 1 m
    done = convert_log(open_log(drive), tmp_path / "there", "mcap")
    assert done.left_out == (f"the type of {FRAMES} of {FRAMES} fixes, which mcap tells by sigma",)


def test_an_unknown_target_and_a_folder_that_is_not_empty_are_refused(tmp_path: Path) -> None:
    log = open_log(full_drive(tmp_path))
    with pytest.raises(ConfigError, match="kitti, euroc, mcap"):
        convert_log(log, tmp_path / "there", "rosbag")
    with pytest.raises(LogError, match="no empty folder"):
        convert_log(log, tmp_path / "07", "kitti")
