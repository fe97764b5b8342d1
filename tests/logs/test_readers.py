"""What every log format must do, through its own writer and reader."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from logs.made_drives import FRAMES, RIG, START_NS, T_CAM_IMU, WRITERS, made_frames, made_packets, made_poses, write_drive
from wayloom.errors import LogError, UnknownFormatError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.logs.drive_writer import DriveWriter, SensorExtrinsics
from wayloom.logs.registry import LOG_FORMATS, MOST_LOOKED, logs_below, open_log
from wayloom.logs.sidecars.oxts import ins_trajectory
from wayloom.logs.types import NOTHING_STATED, FixType, StatedReceiver, StereoFrame
from wayloom.pipeline.log_parts import gnss_digest

formats = pytest.mark.parametrize("log_format", list(LOG_FORMATS))


@formats
def test_what_is_stated_of_the_gnss_receiver_comes_back_and_counts_for_the_geo_reference(tmp_path: Path, log_format: str) -> None:
    writer, name = WRITERS[log_format]
    stated = StatedReceiver(-0.02, 1e-3, 0.01)
    sensors = SensorExtrinsics(np.array([0.1, -0.5, -1.0]), receiver=stated)
    with writer(tmp_path / name, RIG, extrinsics=sensors) as drive:
        for frame in made_frames(FRAMES, True):
            drive.add(frame)
    log = open_log(tmp_path / name)
    assert log.receiver == stated
    silent = open_log(write_drive(tmp_path / "silent", log_format))
    assert silent.receiver == NOTHING_STATED
    before = gnss_digest(log)
    log.receiver = NOTHING_STATED
    assert gnss_digest(log) != before


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ('{"gnss_time_offset_s": 0.1}', "gnss_time_offset_sigma_s"),
        ('{"gnss_time_offset_sigma_s": 0}', "greater than or equal"),
        ('{"p_cam_gnss_sigma_m": 0.1}', "p_cam_gnss_m"),
    ],
)
def test_a_receiver_that_is_stated_by_halves_is_refused(tmp_path: Path, content: str, what: str) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    (drive / "wayloom.json").write_text(content)
    with pytest.raises(LogError, match=what):
        open_log(drive)


def test_every_format_is_tested_here() -> None:
    assert set(WRITERS) == set(LOG_FORMATS)


@formats
@pytest.mark.parametrize("colour", [True, False])
def test_a_written_drive_is_read_back_exactly(tmp_path: Path, log_format: str, colour: bool) -> None:
    log = open_log(write_drive(tmp_path, log_format, colour=colour))
    expected = made_frames(FRAMES, colour)
    assert (log.format, log.colour, len(log)) == (log_format, colour, FRAMES)
    assert (log.rig_id, log.vehicle_id) == ("rig-7", "car-7")
    assert log.t_ns.tolist() == [frame.t_ns for frame in expected]
    for got, frame in zip(log.frames(), expected, strict=True):
        assert (got.index, got.t_ns) == (frame.index, frame.t_ns)
        np.testing.assert_array_equal(got.left, frame.left)
        np.testing.assert_array_equal(got.right, frame.right)
    assert log.rig.camera == RIG.camera
    np.testing.assert_allclose(log.rig.t_right_left, RIG.t_right_left, atol=1e-15)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth, made_poses(FRAMES), atol=1e-8)


@formats
def test_its_gnss_comes_back_with_covariance_and_fix_type(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path, log_format))
    packets = made_packets(FRAMES)
    assert log.gnss is not None
    assert log.gnss.t_ns.tolist() == [packet.t_ns for packet in packets]
    assert log.gnss.lon_lat_height.tolist() == [list(packet.lon_lat_height) for packet in packets]
    assert log.gnss.fix_type.tolist() == [packet.fix for packet in packets]
    for covariance, packet in zip(log.gnss.covariance_enu, packets, strict=True):
        np.testing.assert_allclose(covariance, np.diag([1, 1, 4]) * packet.sigma_m**2)
    np.testing.assert_allclose(log.p_cam_gnss, T_CAM_IMU[:3, 3], atol=1e-12)
    assert log.T_cam_imu is not None
    np.testing.assert_allclose(log.T_cam_imu, T_CAM_IMU, atol=1e-12)
    assert "lever arm" not in log.missing


@formats
def test_a_drive_without_gnss_says_so(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path, log_format, gnss=False))
    assert log.gnss is None
    assert "GNSS" in log.missing


@formats
def test_its_list_of_files_is_enough_to_open_it_elsewhere(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path / "here", log_format))
    assert list(log.files) == sorted(log.files)
    for name in log.files:
        there = tmp_path / "there" / name
        there.parent.mkdir(parents=True, exist_ok=True)
        there.write_bytes((log.root / name).read_bytes())
    copy = open_log(tmp_path / "there")
    assert copy.files == log.files
    assert copy.gnss is not None
    np.testing.assert_array_equal(copy.frame(2).right, log.frame(2).right)
    np.testing.assert_array_equal(copy.p_cam_gnss, log.p_cam_gnss)


@formats
def test_a_part_of_the_frames_can_be_streamed(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path, log_format))
    assert [frame.index for frame in log.frames(2, 4)] == [2, 3]
    assert [frame.index for frame in log.frames(4, 99)] == [4, 5]
    with pytest.raises(IndexError):
        log.frame(FRAMES)


@formats
def test_a_writer_that_is_interrupted_leaves_nothing(tmp_path: Path, log_format: str) -> None:
    writer, name = WRITERS[log_format]
    with pytest.raises(LogError, match="poses are no drive"), writer(tmp_path / name, RIG) as drive:
        write_half(drive)
    assert list(tmp_path.iterdir()) == []


def write_half(drive: DriveWriter) -> None:
    """Two frames, but the pose of the first only."""
    first, second = made_frames(2, True)
    drive.add(first, np.eye(4))
    drive.add(second)


@formats
def test_a_writer_does_not_overwrite_a_drive(tmp_path: Path, log_format: str) -> None:
    folder = write_drive(tmp_path, log_format)
    with pytest.raises(LogError, match="no empty folder"):
        WRITERS[log_format][0](folder, RIG)


@formats
def test_a_writer_refuses_frames_that_do_not_follow_or_fit(tmp_path: Path, log_format: str) -> None:
    writer, name = WRITERS[log_format]
    frame = made_frames(1, True)[0]
    with writer(tmp_path / name, RIG) as drive:
        drive.add(frame)
        with pytest.raises(LogError, match="not after"):
            drive.add(frame)
        with pytest.raises(LogError, match="rig's images"):
            drive.add(StereoFrame(1, frame.t_ns + 1, frame.left[:, :9], frame.right[:, :9]))


def test_the_only_log_inside_a_folder_is_opened_and_two_are_named(tmp_path: Path) -> None:
    write_drive(tmp_path, "kitti-raw")
    assert open_log(tmp_path).format == "kitti-raw"
    write_drive(tmp_path, "kitti-odometry")
    with pytest.raises(UnknownFormatError, match=r"holds 2 logs \(07, 2031_01_02_drive_0007_sync\); .* wayloom inspect .*/07$"):
        open_log(tmp_path)


@formats
def test_a_log_some_levels_below_is_named_and_not_opened(tmp_path: Path, log_format: str) -> None:
    drive = write_drive(tmp_path / "a b" / "c", log_format)
    drive = next(drive.glob("*.mcap"), drive)
    with pytest.raises(UnknownFormatError) as caught:
        open_log(tmp_path)
    told = f"{tmp_path}: is no log, but logs lie below it ({drive.relative_to(tmp_path)})"
    assert str(caught.value) == f"{told}; give one of them, as wayloom inspect '{drive}'"


def test_of_many_logs_below_the_first_few_are_named(tmp_path: Path) -> None:
    for number in range(8):
        (tmp_path / "of a day" / f"{number}" / "image_2").mkdir(parents=True)
    with pytest.raises(UnknownFormatError, match=r"below it \(of a day/0, of a day/1, of a day/2, of a day/3, of a day/4, …\);"):
        open_log(tmp_path)


def test_logs_are_looked_for_at_few_entries_and_not_in_what_is_a_gnss_log_alone(tmp_path: Path) -> None:
    (tmp_path / "gnss" / "0001_sync" / "oxts").mkdir(parents=True)
    (tmp_path / "deep" / "2" / "3" / "4" / "5" / "image_2").mkdir(parents=True)
    (tmp_path / "loop").symlink_to(tmp_path)
    assert logs_below(tmp_path) == []
    (tmp_path / "many").mkdir()
    for number in range(MOST_LOOKED):
        (tmp_path / "many" / f"{number}.txt").touch()
    (tmp_path / "next" / "drive" / "image_2").mkdir(parents=True)
    assert logs_below(tmp_path) == []
    shutil.rmtree(tmp_path / "many")
    assert logs_below(tmp_path) == [tmp_path / "next" / "drive"]


def test_the_ins_trajectory_has_attitude_and_integrates_velocity(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw")
    ins = ins_trajectory(drive)
    seconds = (ins.t_ns - ins.t_ns[0]) / 1e9
    np.testing.assert_allclose(ins.integrated_enu, seconds[:, None] * [8.0, 3.0, 0.1], atol=1e-9)
    assert ins.distance_m == pytest.approx(seconds[-1] * np.linalg.norm([8.0, 3.0, 0.1]))
    np.testing.assert_allclose(ins.T_enu_imu[:, :3, 3], enu_from_lonlatheight(ins.lon_lat_height, MapFrame(*ins.lon_lat_height[0])))
    forward = ins.T_enu_imu[0, :3, 0]
    np.testing.assert_allclose(forward, [np.cos(0.3) * np.cos(0.02), np.sin(0.3) * np.cos(0.02), np.sin(0.02)], atol=1e-12)
    assert len(ins_trajectory(drive / "oxts", first=2, count=3).t_ns) == 3


def test_the_made_drive_begins_when_it_says(tmp_path: Path) -> None:
    assert open_log(write_drive(tmp_path, "kitti-raw")).t_ns[0] == START_NS
    assert FixType.FIXED > FixType.FLOAT > FixType.SINGLE > FixType.NONE


@pytest.mark.parametrize(
    ("log_format", "folders"),
    [("kitti-odometry", ("image_2", "image_3")), ("kitti-raw", ("image_02/data", "image_03/data"))],
)
def test_empty_colour_folders_leave_the_grey_pair(tmp_path: Path, log_format: str, folders: tuple[str, str]) -> None:
    drive = write_drive(tmp_path, log_format, colour=False)
    for folder in folders:
        (drive / folder).mkdir(parents=True)
    log = open_log(drive)
    assert (len(log), log.colour) == (FRAMES, False)
