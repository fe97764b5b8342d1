"""`imu.csv` and `exposure.csv` beside a log."""

from pathlib import Path

import numpy as np
import pytest

from logs.made_drives import FRAMES, START_NS, T_CAM_IMU, WRITERS, made_imu, sample_files, write_drive
from wayloom.errors import LogError
from wayloom.logs.drive_writer import SensorExtrinsics
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import LOG_FORMATS, open_log
from wayloom.logs.sidecars.imu_csv import COLUMNS, read_imu_csv, write_imu_csv
from wayloom.logs.types import ImuTrack

HEADER = f"t_ns,{','.join(COLUMNS)}\n"


def notes(drive: Path) -> Path:
    """Where wayloom.json lies."""
    return next(drive.rglob("wayloom.json")).parent


@pytest.mark.parametrize("log_format", [name for name in LOG_FORMATS if name != "mcap"])
def test_an_imu_and_exposures_beside_a_log_are_read_with_it(tmp_path: Path, log_format: str) -> None:
    drive = write_drive(tmp_path, log_format)
    sample_files(notes(drive))
    log, imu = open_log(drive), made_imu()
    assert log.imu is not None
    assert log.T_cam_imu is not None
    np.testing.assert_array_equal(log.imu.t_ns, imu.t_ns)
    np.testing.assert_array_equal(log.imu.specific_force, imu.specific_force)
    np.testing.assert_array_equal(log.imu.angular_rate, imu.angular_rate)
    np.testing.assert_allclose(log.T_cam_imu, T_CAM_IMU, atol=1e-12)
    np.testing.assert_array_equal(
        [frame.exposure_s for frame in log.frames()], np.random.default_rng(8).uniform(1e-3, 1e-2, (FRAMES, 2))
    )
    assert "IMU" not in log.missing
    assert {"imu.csv", "exposure.csv"} <= {Path(name).name for name in log.files}
    report = inspect_log(log)
    assert report.imu is not None
    assert report.imu.rate_hz == pytest.approx(100)
    assert report.p_cam_imu_m == pytest.approx(T_CAM_IMU[:3, 3])


@pytest.mark.parametrize("log_format", list(LOG_FORMATS))
def test_a_writer_is_given_an_imu_and_exposures(tmp_path: Path, log_format: str) -> None:
    source, exposures = open_log(write_drive(tmp_path / "a", log_format)), np.full((FRAMES, 2), 0.004)
    writer, name = WRITERS[log_format]
    with writer(tmp_path / "b" / name, source.rig, extrinsics=SensorExtrinsics(T_cam_imu=T_CAM_IMU)) as drive:
        for frame in source.frames():
            drive.add(frame)
        drive.set_imu(made_imu())
        drive.set_exposures(exposures)
    log = open_log(tmp_path / "b" / name)
    assert log.imu is not None
    np.testing.assert_array_equal(log.imu.specific_force, made_imu().specific_force)
    assert log.frame(3).exposure_s == (0.004, 0.004)


def test_an_imu_whose_place_is_unknown_is_left_out_and_named(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", gnss=False)
    (drive / "wayloom.json").unlink()
    sample_files(drive)
    log = open_log(drive)
    assert log.imu is None
    assert "T_cam_imu: without it the samples of imu.csv are left out" in log.missing


def test_time_stamps_in_seconds_and_other_columns_are_understood(tmp_path: Path) -> None:
    file = tmp_path / "imu.csv"
    file.write_text(
        f"temperature, t_s,{','.join(COLUMNS)}\n21.5,1317042272.345808896,1,2,3,4,5,6\n21.5,1317042272.355808896,1,2,3,4,5,6\n"
    )
    imu = read_imu_csv(file)
    assert imu.t_ns.tolist() == [START_NS, START_NS + 10_000_000]
    assert imu.angular_rate[1].tolist() == [4, 5, 6]


def test_samples_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    track = ImuTrack(np.cumsum(rng.integers(1, 10**7, 500)), rng.normal(0, 10, (500, 3)), rng.normal(0, 1, (500, 3)))
    write_imu_csv(tmp_path / "imu.csv", track)
    again = read_imu_csv(tmp_path / "imu.csv")
    for name in ("t_ns", "specific_force", "angular_rate"):
        np.testing.assert_array_equal(getattr(again, name), getattr(track, name))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column fx_m_s2 is missing"),
        ("t_ns,fx_m_s2\n", "column fy_m_s2 is missing"),
        (f"{','.join(COLUMNS)}\n", "column t_ns is missing"),
        (HEADER, "no samples"),
        (HEADER + "5,1,2,3,4,5\n", "line 2: 6 fields where 7 belong"),
        (HEADER + "x,1,2,3,4,5,6\n", "line 2: 'x' is not a time in nanoseconds"),
        (HEADER + "5,1,2,nan,4,5,6\n", "line 2: 'nan' is not finite"),
        (HEADER + "5,1,2,3,4,5,6\n5,1,2,3,4,5,6\n", "line 3: time stamp repeats"),
        (HEADER + "5,1,2,3e6,4,5,6\n", r"line 2: a specific force of 3e\+06 m/s\^2 is impossible"),
        (HEADER + "5,1,2,3,4,500,6\n", "line 2: an angular rate of 500 rad/s is impossible"),
    ],
)
def test_a_damaged_imu_csv_names_the_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(LogError, match=message):
        read_imu_csv(tmp_path / "imu.csv")


def test_samples_of_another_clock_are_refused(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    imu = made_imu()
    write_imu_csv(drive / "imu.csv", ImuTrack(imu.t_ns - START_NS, imu.specific_force, imu.angular_rate))
    with pytest.raises(LogError, match="never meet the frames"):
        open_log(drive)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("left,right\n", "line 1: no header of exposures"),
        ("left_s,right_s\n0.1,0.1\n", "1 exposures for 6 frames"),
        ("left_s,right_s\n" + "0.1,0.1\n" * 5 + "0.1,0\n", "line 7: is no exposure"),
        ("left_s,right_s\n" + "0.1,0.1\n" * 5 + "0.1\n", "line 7: 1 numbers where 2 belong"),
    ],
)
def test_a_damaged_exposure_csv_names_the_line(text: str, message: str, tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    (drive / "exposure.csv").write_text(text)
    with pytest.raises(LogError, match=message):
        open_log(drive)
