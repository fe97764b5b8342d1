"""EuRoC drives through real lenses: a world infinitely far away, whose brightness is a function of the direction."""

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from logs.made_drives import START_NS, made_imu, made_poses
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.rectification import DistortedCamera, FisheyeCamera, LensCamera, distorted_rays
from wayloom.logs.drive_writer import ImageEncoding, SensorExtrinsics
from wayloom.logs.euroc.euroc_calibration import EurocCamera
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.types import StereoFrame

FRAMES = 5
STEP_NS = 50_000_000
T_BODY_LEFT = np.array([
    [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
    [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
    [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
    [0.0, 0.0, 0.0, 1.0],
])  # fmt: skip
T_BODY_RIGHT = np.array([
    [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
    [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
    [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
    [0.0, 0.0, 0.0, 1.0],
])  # fmt: skip
"""The published calibration of the EuRoC vehicle."""
LEFT_K, RIGHT_K = (458.654, 457.296, 367.215, 248.375), (457.587, 456.134, 379.999, 255.238)
LEFT_BEND = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0)
RIGHT_BEND = (-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05, 0.0)
FISHEYE_BEND = (0.0034823894, 0.0007150348, -0.0020532361, 0.00020293673)


def radtan_pair(share: float = 0.25) -> tuple[EurocCamera, EurocCamera]:
    """The EuRoC vehicle's cameras with images of a share of 752x480 px."""
    lenses = [DistortedCamera(sized(K, share), bend) for K, bend in ((LEFT_K, LEFT_BEND), (RIGHT_K, RIGHT_BEND))]
    return EurocCamera(lenses[0], rigid(T_BODY_LEFT)), EurocCamera(lenses[1], rigid(T_BODY_RIGHT))


def fisheye_pair() -> tuple[EurocCamera, EurocCamera]:
    """Two equidistant lenses of 150° that look a little past each other."""
    camera = PinholeCamera(60.0, 60.5, 94.0, 58.5, 188, 120)
    turn = se3.exp(np.array([0.11, 0.002, -0.003, 0.02, 0.03, -0.02]))
    left = EurocCamera(FisheyeCamera(camera, FISHEYE_BEND), rigid(T_BODY_LEFT))
    return left, EurocCamera(left.lens, left.T_body_cam @ turn)


def sized(K: tuple[float, float, float, float], share: float) -> PinholeCamera:
    """A camera of the EuRoC vehicle with smaller images."""
    fx, fy, cx, cy = (share * value for value in K)
    return PinholeCamera(fx, fy, cx, cy, int(752 * share), int(480 * share))


def rigid(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """The motion nearest to one that is given with few decimals."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return np.asarray(se3.from_rotation_translation(U @ Vt, T[:3, 3]))


def brightness(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey levels (N,) of the world in directions (N, 3): waves of some 8 degrees, never black."""
    d = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    waves = np.sin(40.0 * d[:, 0] + 3.0 * d[:, 1]) + np.sin(45.0 * d[:, 1] - 5.0 * d[:, 2]) + np.sin(25.0 * (d[:, 0] + d[:, 2]))
    return np.asarray(128.0 + 30.0 * waves)


@functools.cache
def rays_of_pixels(lens: LensCamera) -> NDArray[np.float64]:
    """(h w, 3), of each pixel."""
    v, u = np.mgrid[0 : lens.camera.height, 0 : lens.camera.width].astype(np.float64)
    return distorted_rays(np.column_stack([u.ravel(), v.ravel()]), lens)


def view(lens: LensCamera, R_world_cam: NDArray[np.float64]) -> NDArray[np.uint8]:
    """What a camera records, (h, w)."""
    c = lens.camera
    seen = np.nan_to_num(brightness(rays_of_pixels(lens) @ R_world_cam.T), nan=0.0)
    return np.rint(seen).astype(np.uint8).reshape(c.height, c.width)


def write_euroc(path: Path, cameras: tuple[EurocCamera, EurocCamera], *, right_first: bool = False) -> Path:
    """A drive whose body turns and moves as `made_poses`, through these lenses. right_first: cam0 is the right camera."""
    T_world_left = made_poses(FRAMES)
    T_left_body = se3.inverse(cameras[0].T_body_cam)
    named = cameras[::-1] if right_first else cameras
    T_first_body = se3.inverse(named[0].T_body_cam)
    rig = StereoRig(named[0].lens.camera, (-0.11, 0.0, 0.0))
    sensors = SensorExtrinsics(T_cam_imu=T_first_body)
    with EurocWriter(path, rig, rig_id="rig-9", extrinsics=sensors, encoding=ImageEncoding(colour=False)) as drive:
        drive.cameras = named
        for index, T in enumerate(T_world_left):
            T_world_body = T @ T_left_body
            sides = [view(camera.lens, (T_world_body @ camera.T_body_cam)[:3, :3]) for camera in named]
            drive.add(StereoFrame(index, START_NS + STEP_NS * index, *sides), T_world_body @ named[0].T_body_cam)
        drive.set_imu(made_imu())
    return path
