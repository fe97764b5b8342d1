"""Drives as the lens made them (`…_extract`) are rectified on load: a made world, seen through KITTI's lenses."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.errors import CalibrationError
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import DistortedCamera, undistort
from wayloom.logs.drive_writer import numbers_text
from wayloom.logs.kitti.image_folder_log import ImageFolderLog
from wayloom.logs.registry import open_log

# KITTI's 2011_09_26 colour pair at half size: K, D, R_rect of cameras 02 and 03.
K = {
    "02": (479.9, 478.5, 347.8, 111.9),
    "03": (451.9, 451.0, 347.6, 111.9),
}
D = {"02": (-0.3691, 0.1969, 1.353e-3, 5.678e-4, -0.0677), "03": (-0.3640, 0.1789, 6.030e-4, -3.922e-4, -0.0538)}
ROTATION = {"02": (0.0009558, -0.0028343, -0.0151159), "03": (-0.0023545, -0.0168483, 0.0072132)}
RECTIFIED = PinholeCamera(360.77, 360.77, 304.53, 86.18, 621, 187)
T_RIGHT_LEFT = np.array([-0.5327, 0.00275, 0.0])
RAW_SIZE = (696, 256)


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth picture on a wall 10 m ahead, x and y in m, 0 to 255."""
    return 127.5 + 60 * np.sin(3.1 * x + 0.4 * y) + 55 * np.cos(3.9 * y - 0.8 * x)


def wall(rays_rect: np.ndarray, camera: str) -> np.ndarray:
    """What a rectified camera sees along rays (N, 3) with z = 1 of the wall 10 m ahead of the left one."""
    t = T_RIGHT_LEFT if camera == "03" else np.zeros(3)
    points_left = rays_rect * 10.0 - t
    return texture(points_left[:, 0], points_left[:, 1])


@lru_cache
def through_lens(camera: str) -> np.ndarray:
    """The distorted picture, by undoing the lens at each of its pixels."""
    fx, fy, cx, cy = K[camera]
    v, u = np.mgrid[0 : RAW_SIZE[1], 0 : RAW_SIZE[0]].astype(float)
    xy = undistort(np.column_stack([(u.ravel() - cx) / fx, (v.ravel() - cy) / fy]), D[camera])
    rays = np.column_stack([np.nan_to_num(xy), np.ones(len(xy))]) @ cv2.Rodrigues(np.array(ROTATION[camera]))[0].T
    return np.round(wall(rays / rays[:, 2:], camera)).astype(np.uint8).reshape(RAW_SIZE[1], RAW_SIZE[0])


def ideal(camera: str) -> np.ndarray:
    """The picture of the ideal rectified camera."""
    v, u = np.mgrid[0 : RECTIFIED.height, 0 : RECTIFIED.width].astype(float)
    return wall(RECTIFIED.rays(np.column_stack([u.ravel(), v.ravel()])), camera).reshape(u.shape)


def write_extract(folder: Path, suffix: str = ".png") -> Path:
    """A distorted drive of two frames, its calibration beside it, time stamps of the right camera only."""
    drive = folder / "2011_09_26_drive_0009_extract"
    lines = []
    for camera in ("02", "03"):
        images = drive / f"image_{camera}" / "data"
        images.mkdir(parents=True)
        for i in range(2):
            cv2.imwrite(
                str(images / f"{i:010d}{suffix}"), through_lens(camera), [cv2.IMWRITE_JPEG_QUALITY, 100] if suffix == ".jpg" else []
            )
        fx, fy, cx, cy = K[camera]
        t = T_RIGHT_LEFT if camera == "03" else np.zeros(3)
        P = np.column_stack([RECTIFIED.K, RECTIFIED.K @ t])
        lines += [f"S_{camera}: {RAW_SIZE[0]} {RAW_SIZE[1]}", f"S_rect_{camera}: {RECTIFIED.width} {RECTIFIED.height}"]
        lines += [f"K_{camera}: {fx} 0 {cx} 0 {fy} {cy} 0 0 1", f"D_{camera}: {numbers_text(np.array(D[camera]))}"]
        lines += [f"R_rect_{camera}: {numbers_text(cv2.Rodrigues(np.array(ROTATION[camera]))[0])}"]
        lines += [f"P_rect_{camera}: {numbers_text(P)}"]
    (folder / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n" + "\n".join(lines) + "\n")
    (drive / "image_03/timestamps.txt").write_text("".join(wall_clock_from_ns(i * 10**8) + "\n" for i in range(2)))
    return drive


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_distorted_drive_comes_out_as_the_ideal_cameras_see_it(tmp_path: Path, suffix: str) -> None:
    log = open_log(write_extract(tmp_path, suffix))
    assert isinstance(log, ImageFolderLog)
    assert log.rectifier is not None
    assert (log.rig.camera, log.stored_sizes[0]) == (RECTIFIED, RAW_SIZE)
    np.testing.assert_allclose(log.rig.t_right_left, T_RIGHT_LEFT, atol=1e-12)
    assert "image_02/timestamps.txt" in log.missing
    frame = log.frame(1)
    for got, camera in ((frame.left, "02"), (frame.right, "03")):
        expected = ideal(camera)
        assert got.shape == expected.shape
        seen = cv2.erode((got > 0).astype(np.uint8), np.ones((5, 5))) > 0
        assert seen.mean() > 0.9
        assert shift_px(got.astype(float), expected, seen) == pytest.approx((0.0, 0.0), abs=0.02)
        assert np.abs(got - expected)[seen].mean() < (0.6 if suffix == ".png" else 1.2)


def shift_px(got: np.ndarray, expected: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """The shift (u, v) that explains got best, by least squares on the gradient (Lucas and Kanade, 1981)."""
    gv, gu = np.gradient(expected)
    A = np.column_stack([-gu[seen], -gv[seen]])
    du, dv = np.linalg.lstsq(A, (got - expected)[seen], rcond=None)[0]
    return float(du), float(dv)


def test_the_check_itself_sees_a_shift_of_a_tenth_of_a_pixel() -> None:
    moved = PinholeCamera(RECTIFIED.fx, RECTIFIED.fy, RECTIFIED.cx + 0.1, RECTIFIED.cy, RECTIFIED.width, RECTIFIED.height)
    v, u = np.mgrid[0 : RECTIFIED.height, 0 : RECTIFIED.width].astype(float)
    other = wall(moved.rays(np.column_stack([u.ravel(), v.ravel()])), "02").reshape(u.shape)
    assert shift_px(other, ideal("02"), np.ones(u.shape, bool)) == pytest.approx((0.1, 0.0), abs=0.01)


def test_rectified_images_in_a_drive_that_is_called_distorted_are_taken_as_they_are(tmp_path: Path) -> None:
    drive = write_extract(tmp_path)
    for file in drive.glob("image_*/data/*.png"):
        cv2.imwrite(str(file), np.zeros((RECTIFIED.height, RECTIFIED.width), np.uint8))
    log = open_log(drive)
    assert isinstance(log, ImageFolderLog)
    assert log.rectifier is None


@pytest.mark.parametrize("key", ["K_02", "D_03", "R_rect_02", "S_rect_02", "S_03", "P_rect_03"])
def test_a_lens_that_is_not_whole_is_named(tmp_path: Path, key: str) -> None:
    drive = write_extract(tmp_path)
    file = tmp_path / "calib_cam_to_cam.txt"
    file.write_text(file.read_text().replace(f"{key}:", f"{key}: 1"))
    with pytest.raises(CalibrationError, match=rf"calib_cam_to_cam.txt, {key}, line \d+: .* numbers where .* belong"):
        open_log(drive)


@pytest.mark.parametrize(
    ("key", "old", "new"), [("D_02", "-0.3691", "-1000"), ("K_03", "451.9", "0"), ("R_rect_03", "0.99", "9.99")]
)
def test_a_lens_that_cannot_be_is_named(tmp_path: Path, key: str, old: str, new: str) -> None:
    drive = write_extract(tmp_path)
    file = tmp_path / "calib_cam_to_cam.txt"
    file.write_text(file.read_text().replace(f"{key}: {old}", f"{key}: {new}"))
    with pytest.raises(CalibrationError, match=f"calib_cam_to_cam.txt, {key}: "):
        open_log(drive)


def test_a_lens_type_is_what_the_reader_makes_of_kitti_s_lines() -> None:
    lens = DistortedCamera(PinholeCamera(*K["02"], *RAW_SIZE), D["02"])
    assert lens.camera.K[0].tolist() == [479.9, 0.0, 347.8]
