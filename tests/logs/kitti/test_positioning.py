"""Which GNSS fix belongs to which frame, and where the antenna sits."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from logs.made_drives import FRAMES, START_NS, T_CAM_IMU, made_frames, write_drive
from wayloom.errors import LogError, UnknownFormatError
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.gnss_csv import write_gnss_csv
from wayloom.logs.sidecars.oxts import Field, fix_types
from wayloom.logs.types import FixType, GnssTrack


def two_drives(folder: Path) -> tuple[Path, Path]:
    """A drive without GNSS, and a raw drive whose oxts is to be lent to it."""
    return write_drive(folder / "log", "kitti-odometry", gnss=False), write_drive(folder / "lender", "kitti-raw", count=FRAMES + 4)


@pytest.mark.parametrize("part", ["", "oxts"])
def test_a_packet_of_a_lent_log_takes_the_time_of_the_frame_with_its_number(tmp_path: Path, part: str) -> None:
    log_folder, lender = two_drives(tmp_path)
    log = open_log(log_folder, gnss=lender / part)
    assert log.gnss is not None
    np.testing.assert_array_equal(log.gnss.t_ns, log.t_ns)
    lent = open_log(lender).gnss
    assert lent is not None
    np.testing.assert_array_equal(log.gnss.lon_lat_height, lent.lon_lat_height[:FRAMES])
    assert not any("oxts" in name for name in log.files)


def test_a_clip_cut_from_the_middle_of_a_drive_keeps_its_packets(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    for side in ("image_2", "image_3"):
        for number in range(3):
            (log_folder / side / f"{number:06d}.png").unlink()
    log = open_log(log_folder, gnss=lender)
    lent = open_log(lender).gnss
    assert log.gnss is not None
    assert lent is not None
    np.testing.assert_array_equal(log.gnss.lon_lat_height, lent.lon_lat_height[3:FRAMES])
    assert log.t_ns.tolist() == [frame.t_ns for frame in made_frames(FRAMES, True)[3:]]
    assert log.truth is not None
    assert log.truth[0, 2, 3] > 2.9


def test_frames_without_a_packet_are_counted_as_missing(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    for number in (2, 5, 6, 7, 8, 9):
        (lender / "oxts/data" / f"{number:010d}.txt").unlink()
    (lender / "oxts/timestamps.txt").unlink()
    log = open_log(log_folder, gnss=lender)
    assert log.gnss is not None
    assert log.gnss.t_ns.tolist() == log.t_ns[[0, 1, 3, 4]].tolist()
    assert "GNSS for 2 of 6 frames" in log.missing


def test_the_unit_of_a_lent_log_is_placed_by_the_calibration_beside_it(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    (log_folder / "wayloom.json").unlink()
    np.testing.assert_allclose(open_log(log_folder, gnss=lender).p_cam_gnss, T_CAM_IMU[:3, 3], atol=1e-12)
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        shutil.move(lender / name, lender.parent / name)
    np.testing.assert_allclose(open_log(log_folder, gnss=lender / "oxts").p_cam_gnss, T_CAM_IMU[:3, 3], atol=1e-12)
    (lender.parent / "calib_imu_to_velo.txt").unlink()
    log = open_log(log_folder, gnss=lender)
    assert log.p_cam_gnss.tolist() == [0, 0, 0]
    assert "lever arm" in log.missing


def test_the_lever_arm_of_the_sidecar_counts_most(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw")
    (drive / "wayloom.json").write_text('{"p_cam_gnss_m": [0, 0, 0]}')
    log = open_log(drive)
    assert log.p_cam_gnss.tolist() == [0, 0, 0]
    assert "lever arm" not in log.missing


def test_packets_of_another_clock_inside_a_log_go_by_number(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    stamps = "".join(wall_clock_from_ns(i * 10**8) + "\n" for i in range(FRAMES))
    (drive / "oxts/timestamps.txt").write_text(stamps)
    log = open_log(drive)
    assert log.gnss is not None
    np.testing.assert_array_equal(log.gnss.t_ns, log.t_ns)


def test_packets_faster_than_frames_are_also_imu_samples(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw")
    packet = (drive / "oxts/data/0000000000.txt").read_text()
    for number in range(70):
        (drive / "oxts/data" / f"{number:010d}.txt").write_text(packet)
    (drive / "oxts/timestamps.txt").write_text("".join(wall_clock_from_ns(START_NS + i * 10**7) + "\n" for i in range(70)))
    log = open_log(drive)
    assert log.imu is not None
    assert log.imu.specific_force[3].tolist() == [0, 0, 9.81]
    assert "IMU" not in log.missing


def track() -> GnssTrack:
    t_ns = np.array([frame.t_ns for frame in made_frames(FRAMES, True)])
    rng = np.random.default_rng(0)
    A = rng.normal(size=(FRAMES, 3, 3))
    place = np.array([8.4, 49.0, 115.0]) + rng.normal(size=(FRAMES, 3)) * [1e-5, 1e-5, 1]
    fixes = np.array([FixType.FIXED, FixType.NONE, FixType.SINGLE] * 2, dtype=np.uint8)
    return GnssTrack(t_ns, place, A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(3), fixes)


def test_fixes_of_a_csv_file_come_back_exactly(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", gnss=False)
    for file, given in ((drive / "gnss.csv", None), (tmp_path / "elsewhere.csv", tmp_path / "elsewhere.csv")):
        write_gnss_csv(file, track())
        log = open_log(drive, gnss=given)
        assert log.gnss is not None
        np.testing.assert_array_equal(log.gnss.t_ns, track().t_ns)
        np.testing.assert_array_equal(log.gnss.lon_lat_height, track().lon_lat_height)
        np.testing.assert_allclose(log.gnss.covariance_enu, track().covariance_enu, rtol=1e-15)
        np.testing.assert_array_equal(log.gnss.fix_type, track().fix_type)
    assert "gnss.csv" in open_log(drive).files


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "column lon_deg is missing"),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m\n", "column sigma_u_m is missing"),
        ("lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n", "column t_ns is missing"),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n", "no fixes"),
        (
            "t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n1,8,49,100,1,1,0\n",
            "line 2: the covariance is not positive",
        ),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n1,8,99,100,1,1,1\n", "line 2: is no place"),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n1,8,x,100,1,1,1\n", "line 2: 'x' is not a number"),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n1,8\n", r"line 2: '\?' is not a number"),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\nx,8,9,100,1,1,1\n", "line 2: 'x' is not a time"),
        (
            "t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m,fix\n1,8,9,100,1,1,1,rtk\n",
            "'rtk' is no fix type; known are none",
        ),
        (
            "t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n2,8,9,1,1,1,1\n1,8,9,1,1,1,1\n",
            "line 3: time stamp goes back",
        ),
        ("t_s,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m\n1,8,49,100,1,1,1\n", "never meet the frames"),
    ],
)
def test_a_spoilt_csv_file_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", gnss=False)
    (drive / "gnss.csv").write_text(text)
    with pytest.raises(LogError, match=said):
        open_log(drive)


def test_a_gnss_path_that_is_none_is_said(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", gnss=False)
    with pytest.raises(LogError, match="no such file or folder; give a KITTI"):
        open_log(drive, gnss=tmp_path / "nowhere")
    with pytest.raises(UnknownFormatError, match=r"no GNSS log: looked for oxts/data, data and a \.csv file"):
        open_log(drive, gnss=drive / "image_2")
    with pytest.raises(UnknownFormatError, match="no GNSS log"):
        open_log(drive, gnss=drive / "calib.txt")


def test_a_lent_log_of_other_numbers_is_refused(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    for file in (lender / "oxts/data").iterdir():
        file.rename(file.with_name(f"{int(file.stem) + 500:010d}.txt"))
    with pytest.raises(LogError, match=r"no packet has the number of a frame \(0 to 5\)"):
        open_log(log_folder, gnss=lender)


def test_packets_of_another_pace_are_not_taken_for_one_a_frame(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    (lender / "oxts/timestamps.txt").write_text("".join(wall_clock_from_ns(i * 10**7) + "\n" for i in range(FRAMES + 4)))
    with pytest.raises(
        LogError, match=r"6 packets span 0.05 s, the frames of their numbers 0.70 s; give a log with one packet a frame"
    ):
        open_log(log_folder, gnss=lender)


def test_an_extract_log_that_is_lent_goes_by_its_clock(tmp_path: Path) -> None:
    log_folder, lender = two_drives(tmp_path)
    lender = lender.rename(lender.with_name("2031_01_02_drive_0007_extract"))
    log = open_log(log_folder, gnss=lender)
    assert log.gnss is not None
    assert len(log.gnss) == FRAMES + 4
    assert log.gnss.t_ns[0] == START_NS + 4_000_000


@pytest.mark.parametrize("log_format", ["kitti-odometry", "kitti-raw"])
def test_a_log_is_the_same_from_inside_its_folder(tmp_path: Path, log_format: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = write_drive(tmp_path, log_format)
    expected = open_log(drive)
    monkeypatch.chdir(drive)
    for path in (Path(), Path("..") / drive.name):
        log = open_log(path)
        assert (log.files, log.root, log.name) == (expected.files, expected.root, expected.name)


def test_a_place_that_the_unit_bridged_by_inertia_counts_as_a_single_fix() -> None:
    packets = np.zeros((5, len(Field)))
    packets[:, Field.POS_ACCURACY] = [0.7, 10.0, 11.0, 0.0, 0.7]
    packets[:, Field.NAVSTAT] = [4, 4, 4, 4, 3]
    assert fix_types(packets).tolist() == [FixType.SINGLE, FixType.SINGLE, FixType.NONE, FixType.NONE, FixType.NONE]
    packets[:, Field.POSMODE] = [-1, 5, 6, 3, 99]
    assert fix_types(packets).tolist() == [FixType.SINGLE, FixType.FLOAT, FixType.FIXED, FixType.SINGLE, FixType.SINGLE]


@pytest.mark.real_data
def test_clip_a_is_placed_by_the_log_of_its_drive(clip_a: Path, clip_a_gnss: Path) -> None:
    log = open_log(clip_a, gnss=clip_a_gnss)
    assert log.gnss is not None
    np.testing.assert_array_equal(log.gnss.t_ns, log.t_ns)
    np.testing.assert_allclose(log.gnss.lon_lat_height[0], [8.390366, 48.982545, 116.38], atol=1e-2)
    np.testing.assert_allclose(log.p_cam_gnss, [-0.339, 0.747, -1.096], atol=1e-3)
    assert np.bincount(log.gnss.fix_type, minlength=4).tolist() == [0, 14, 89, 98]
    assert any("R_rect_00" in what for what in log.missing)


@pytest.mark.real_data
def test_clip_b_knows_where_its_unit_sits(clip_b: Path) -> None:
    """The unit's height over the camera and its way behind it, against the drawing of the car: 0.93 m, 1.65 m mounting heights."""
    log = open_log(clip_b)
    np.testing.assert_allclose(log.p_cam_gnss, [-0.254, 0.719, -1.086], atol=1e-3)
    assert log.p_cam_gnss[1] == pytest.approx(1.65 - 0.93, abs=0.03)
