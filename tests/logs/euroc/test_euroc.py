"""EuRoC folders: lenses and mountings of a real vehicle, rectified on load."""

import functools
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from logs.euroc.euroc_kit import (
    FRAMES,
    LEFT_BEND,
    RIGHT_BEND,
    STEP_NS,
    T_BODY_LEFT,
    brightness,
    fisheye_pair,
    radtan_pair,
    write_euroc,
)
from logs.made_drives import START_NS, made_imu, made_poses, write_drive
from wayloom.errors import CalibrationError, InputError, LogError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import DistortedCamera
from wayloom.geometry.stereo_rectification import rectify_stereo
from wayloom.logs.euroc.euroc_calibration import EurocCamera
from wayloom.logs.inspection import inspect_log
from wayloom.logs.kitti.image_folder_log import ImageFolderLog
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.exposure_csv import write_exposure_csv

Pair = Callable[[], tuple[EurocCamera, EurocCamera]]


@functools.cache
def made_drive() -> tuple[tempfile.TemporaryDirectory[str], Path]:
    """A drive through the EuRoC vehicle's lenses, which the tests copy."""
    folder = tempfile.TemporaryDirectory()
    return folder, write_euroc(Path(folder.name) / "V9_01_made", radtan_pair())


def copied(folder: Path) -> Path:
    """A copy of `made_drive`."""
    return shutil.copytree(made_drive()[1], folder / "V9_01_made")


def rays_of(log: ImageFolderLog) -> np.ndarray:
    camera = log.rig.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    return camera.rays(np.column_stack([u.ravel(), v.ravel()]))


@pytest.mark.parametrize("pair", [radtan_pair, fisheye_pair])
@pytest.mark.parametrize("right_first", [False, True])
def test_rectified_images_show_in_every_pixel_what_lies_along_its_ray(tmp_path: Path, pair: Pair, right_first: bool) -> None:
    log = open_log(write_euroc(tmp_path / "V9_01_made", pair(), right_first=right_first))
    assert isinstance(log, ImageFolderLog)
    assert (log.format, log.rectifies, len(log), log.colour) == ("euroc", True, FRAMES, False)
    assert log.truth is not None
    for index in (0, FRAMES - 1):
        frame = log.frame(index)
        seen = brightness(rays_of(log) @ log.truth[index, :3, :3].T).reshape(frame.left.shape)
        for image in (frame.left, frame.right):  # the world is infinitely far away: both see the same
            error = np.abs(image - seen)
            # bilinear: second derivative of three waves of amplitude 30, at most 45 rad a radian, over 1/8 px²; and two roundings
            bound = 3 * 30.0 * (45.0 / log.rig.camera.fx) ** 2 / 4 * 1.5 + 1.0
            assert error.max() < bound
        np.testing.assert_array_equal(log.grey_side(index, True), frame.right)


def test_no_pixel_of_a_rectified_image_is_one_that_the_lens_did_not_see(tmp_path: Path) -> None:
    log = open_log(copied(tmp_path))
    assert all(min(frame.left.min(), frame.right.min()) > 0 for frame in log.frames())  # the world is never black


def test_the_rectified_orientation_is_that_of_opencv() -> None:
    left, right = radtan_pair(1.0)
    T_right_left = se3.inverse(right.T_body_cam) @ left.T_body_cam
    size = (752, 480)
    K = [np.array(camera.lens.camera.K) for camera in (left, right)]
    R_left, R_right = cv2.stereoRectify(
        K[0], np.array(LEFT_BEND), K[1], np.array(RIGHT_BEND), size, T_right_left[:3, :3].copy(), T_right_left[:3, 3:].copy()
    )[:2]
    found = rectify_stereo(left.lens, right.lens, se3.inverse(T_right_left))
    # both are turned about the baseline by halves of the cameras' difference, which OpenCV measures another way: 1e-5 rad here
    np.testing.assert_allclose(found.R_left, R_left, atol=2e-5)
    np.testing.assert_allclose(found.R_right, R_right, atol=2e-5)
    assert found.rig.baseline_m == pytest.approx(0.110077842, abs=1e-9)
    assert 420 < found.rig.camera.fx < 460


@pytest.mark.parametrize("turn_rad", [0.5, -0.5])
def test_lenses_that_see_nothing_together_are_refused(turn_rad: float) -> None:
    lens = DistortedCamera(PinholeCamera(500.0, 500.0, 50.0, 30.0, 100, 60), (0.0,) * 5)  # of 11 degrees
    T_left_right = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, turn_rad, 0.0]))
    T_left_right[0, 3] = 0.1
    with pytest.raises(CalibrationError, match=r"sensor.yaml: .*see nothing together.*; .") as refused:
        rectify_stereo(lens, lens, T_left_right, Path("cam1/sensor.yaml"))
    assert refused.value.remedy


@pytest.mark.parametrize("axis", range(3))
def test_cameras_turned_against_each_other_by_more_than_an_eighth_of_a_circle_are_refused(tmp_path: Path, axis: int) -> None:
    left, right = radtan_pair()
    turn = np.zeros(6)
    turn[3 + axis] = np.radians(50.0)
    T_left_right = se3.inverse(left.T_body_cam) @ right.T_body_cam
    T_left_right[:3, :3] = se3.exp(turn)[:3, :3]
    turned = EurocCamera(right.lens, left.T_body_cam @ T_left_right)
    with pytest.raises(CalibrationError, match="turned against each other by more than 45°"):
        open_log(write_euroc(tmp_path / "V9_01_made", (left, turned)))


def test_imu_and_truth_are_told_in_the_rectified_camera(tmp_path: Path) -> None:
    log = open_log(copied(tmp_path))
    assert log.imu is not None
    assert log.T_cam_imu is not None
    assert log.truth is not None
    made = made_imu()
    np.testing.assert_array_equal(log.imu.t_ns, made.t_ns)
    np.testing.assert_array_equal(log.imu.specific_force, made.specific_force)
    np.testing.assert_array_equal(log.imu.angular_rate, made.angular_rate)
    # the left camera's place does not depend on rectification; its T_BS is the published one, rounded to a rotation
    np.testing.assert_allclose(log.truth[:, :3, 3], made_poses(FRAMES)[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(se3.inverse(log.T_cam_imu)[:3, 3], T_BODY_LEFT[:3, 3], atol=1e-9)
    T_world_imu = log.truth @ log.T_cam_imu
    np.testing.assert_allclose(T_world_imu, made_poses(FRAMES) @ se3.inverse(radtan_pair()[0].T_body_cam), atol=1e-12)


def test_the_inner_folder_is_the_same_drive(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    outer, inner = open_log(drive), open_log(drive / "mav0")
    assert (inner.name, len(inner), inner.rig) == (outer.name, len(outer), outer.rig)


def test_images_without_a_partner_and_listed_ones_that_are_not_there_are_left_out_and_counted(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    (drive / "mav0/cam0/data" / f"{START_NS + STEP_NS}.png").unlink()
    table = drive / "mav0/cam1/data.csv"
    table.write_text("\r\n".join(line for line in table.read_text().splitlines() if str(START_NS + 3 * STEP_NS) not in line))
    log = open_log(drive)
    assert ((log.t_ns - START_NS) // STEP_NS).tolist() == [0, 2, 4]
    assert set(log.missing) == {
        "1 of 5 images that cam0/data.csv lists", "cam1 image for 1 of 4 of cam0", "cam0 image for 1 of 4 of cam1", "GNSS",
    }  # fmt: skip
    assert inspect_log(log).usable


def test_packets_and_exposures_stay_with_their_frames_where_an_image_is_missing(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    (drive / "mav0/cam1/data" / f"{START_NS + STEP_NS}.png").unlink()
    exposures = np.column_stack([np.arange(1, FRAMES + 1), np.arange(1, FRAMES + 1)]) * 1e-3
    write_exposure_csv(drive / "exposure.csv", exposures)
    lender = write_drive(tmp_path / "lender", "kitti-raw", count=FRAMES)
    lent = open_log(lender).gnss
    (lender / "oxts/timestamps.txt").unlink()  # its frames come at half the pace
    log = open_log(drive, gnss=lender)
    there = [0, *range(2, FRAMES)]
    assert log.gnss is not None
    assert lent is not None
    np.testing.assert_array_equal(log.gnss.lon_lat_height, lent.lon_lat_height[there])
    np.testing.assert_array_equal(log.gnss.t_ns, log.t_ns)
    assert [frame.exposure_s for frame in log.frames()] == [tuple(exposures[row]) for row in there]


def test_stamps_of_both_cameras_may_differ_by_what_a_trigger_jitters(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    table = drive / "mav0/cam1/data.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    table.write_text("".join(f"{int(stamp) + 900_000},{name}\n" for stamp, name in rows))
    log = open_log(drive)
    assert log.t_ns.tolist() == [START_NS + STEP_NS * index for index in range(FRAMES)]
    assert "cam1" not in " ".join(log.missing)


def test_truth_between_two_poses_is_interpolated_and_beyond_them_unknown(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    table = drive / "mav0/state_groundtruth_estimate0/data.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], lines[2], lines[4]]) + "\n")  # of frames 1 and 3, 0.1 s apart
    log = open_log(drive)
    assert log.truth is not None
    assert np.isfinite(log.truth).all(axis=(1, 2)).tolist() == [False, True, True, True, False]
    np.testing.assert_allclose(log.truth[1, :3, 3], made_poses(FRAMES)[1, :3, 3], atol=1e-12)
    # a turn of 0.02 rad a metre: half way the chord is 1 m · 0.02 / 2 from the arc, and the body's lever of 7 cm adds 1e-3 of that
    np.testing.assert_allclose(log.truth[2, :3, 3], made_poses(FRAMES)[2, :3, 3], atol=0.0105)


def test_a_drive_without_imu_and_truth_says_so(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    shutil.rmtree(drive / "mav0/imu0")
    shutil.rmtree(drive / "mav0/state_groundtruth_estimate0")
    log = open_log(drive)
    assert (log.imu, log.truth, log.gnss) == (None, None, None)
    assert set(log.missing) == {"IMU", "truth poses", "GNSS"}


def test_images_that_need_no_rectification_are_not_resampled(tmp_path: Path) -> None:
    log = open_log(write_drive(tmp_path, "euroc"))
    assert isinstance(log, ImageFolderLog)
    assert not log.rectifies


def test_yaml_as_opencv_and_as_people_write_it_is_read(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    before = open_log(drive)
    file = drive / "mav0/cam0/sensor.yaml"
    text = file.read_text().replace("  data: [", "  data: [  # rows first\n    ").replace(", ", ",\n      ")
    file.write_text("%YAML:1.0\n---\n# General sensor definitions.\r\n" + text.replace("pinhole", "'pinhole'"))
    assert open_log(drive).rig == before.rig


Spoil = Callable[[Path], object]


def replace(name: str, old: str, new: str) -> Spoil:
    def spoil(body: Path) -> None:
        text = (body / name).read_text()
        assert old in text
        (body / name).write_text(text.replace(old, new, 1))

    return spoil


REFUSED: dict[str, tuple[Spoil, type[InputError], tuple[str, ...]]] = {
    "no second camera": (lambda body: shutil.rmtree(body / "cam1"), LogError, ("cam1", "no such folder", "both cameras")),
    "no calibration": (lambda body: (body / "cam1/sensor.yaml").unlink(), CalibrationError, ("cam1/sensor.yaml", "no such file")),
    "no list": (lambda body: (body / "cam0/data.csv").unlink(), LogError, ("cam0/data.csv", "no such file", "list the camera's")),
    "a cut list of numbers": (
        lambda body: (body / "cam0/sensor.yaml").write_text((body / "cam0/sensor.yaml").read_text()[:120]),
        CalibrationError,
        ("cam0/sensor.yaml, T_BS.data", "not closed"),
    ),
    "another model": (replace("cam0/sensor.yaml", "pinhole", "omni"), CalibrationError, ("camera_model", "'omni'", "pinhole")),
    "another bend": (
        replace("cam0/sensor.yaml", "radial-tangential", "fov"),
        CalibrationError,
        ("distortion_model", "'fov'", "equidistant"),
    ),
    "no rotation": (replace("cam1/sensor.yaml", "data: [", "data: [9"), CalibrationError, ("T_BS.data", "no rigid motion")),
    "not a number": (replace("cam1/sensor.yaml", "data: [", "data: [nan, "), CalibrationError, ("T_BS.data", "not finite")),
    "a word in a list over lines": (
        replace("cam1/sensor.yaml", "data: [", "data: [0,\n  # and\n\n    1,O, "),
        CalibrationError,
        ("cam1/sensor.yaml, T_BS.data, line 9: 'O' is not a number; correct the file",),
    ),
    "no size": (replace("cam0/sensor.yaml", "[188", "[0"), CalibrationError, ("resolution", "0x120")),
    "another size": (replace("cam0/sensor.yaml", "[188", "[189"), LogError, ("188x120", "189x120")),
    "an alias": (
        lambda body: (body / "cam0/sensor.yaml").write_text("a: &a [1]\nb: [*a, *a]\n- c\n"),
        CalibrationError,
        ("line 3", "not understood"),
    ),
    "a way out": (replace("cam0/data.csv", f",{START_NS}.png", ",../../../x.png"), LogError, ("line 2", "no name of an image")),
    "a stamp that is none": (replace("cam0/data.csv", f"\n{START_NS},", "\n1e99,"), LogError, ("line 2", "no time in nanoseconds")),
    "an absurd stamp": (replace("cam0/data.csv", f"\n{START_NS},", f"\n{10**30},"), LogError, ("line 2", "no time in nanoseconds")),
    "a stamp twice": (
        replace("cam0/data.csv", f"\n{START_NS + STEP_NS},", f"\n{START_NS},"),
        LogError,
        ("cam0/data.csv, line 3", "repeats"),
    ),
    "a missing column": (replace("imu0/data.csv", "w_RS_S_y", "wy"), LogError, ("imu0/data.csv, line 1", "w_RS_S_y is missing")),
    "a force in g": (
        lambda body: (body / "imu0/data.csv").write_text(f"{START_NS},0,0,0,0,9810,0\n{START_NS + 5_000_000},0,0,0,0,0,0\n"),
        LogError,
        ("imu0/data.csv, line 1", "9810 m/s^2"),
    ),
    "a quaternion that is none": (
        lambda body: (body / "state_groundtruth_estimate0/data.csv").write_text(f"{START_NS},0,0,0,0,0,0,0\n"),
        LogError,
        ("line 1", "quaternion of length 0"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_is_wrong_is_told_in_one_line_with_file_record_and_remedy(tmp_path: Path, case: str) -> None:
    spoil, error, words = REFUSED[case]
    drive = copied(tmp_path)
    spoil(drive / "mav0")
    with pytest.raises(error) as refused:
        open_log(drive)
    assert all(word in str(refused.value) for word in words), str(refused.value)
    assert "\n" not in str(refused.value)
    assert refused.value.remedy


def test_samples_on_another_clock_are_refused_and_stale_ones_left_out(tmp_path: Path) -> None:
    drive = copied(tmp_path)
    table = drive / "mav0/imu0/data.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*lines[:5], lines[3], *lines[5:]]) + "\n")
    log = open_log(drive)
    assert log.imu is not None
    assert len(log.imu.t_ns) == len(lines) - 1
    assert "1 samples of imu0 whose time stamp is not after the one before" in log.missing
    table.write_text("\n".join([lines[0], *(f"2{line[1:]}" for line in lines[1:])]) + "\n")
    with pytest.raises(LogError, match="never meet the frames"):
        open_log(drive)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("../x.png", "file.outside"), (".hidden.png", "file.outside"), (f"{START_NS}.txt", "log.invalid")],
)
def test_only_a_name_that_leads_elsewhere_is_said_to(tmp_path: Path, name: str, reason: str) -> None:
    drive = copied(tmp_path)
    replace("cam0/data.csv", f",{START_NS}.png", f",{name}")(drive / "mav0")
    with pytest.raises(LogError, match="no name of an image") as refused:
        open_log(drive)
    assert refused.value.reason == reason
