"""Depth errors of the odometry's points, against ground-truth images of the simulated city and against LiDAR."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, VOID
from wayloom.errors import LogError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.logs.kitti.kitti_calibration import (
    CAM_TO_CAM,
    VELO_TO_CAM,
    read_calibration,
    rigid_from,
    t_cam_reference,
)
from wayloom.logs.simulated_truth import DEPTH_PER_M
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NEAR_M, SURFACE_M, SURFACE_ERROR_M, RELATIVE_ERROR, DISPARITY_ERROR_PX = 30.0, 15.0, 0.10, 0.05, 2.0
CENTRE_X = 0.3
"""Normalised image coordinate up to which a point counts as in the middle of the image."""
SURFACES = tuple(CLASS_ID[name] for name in ("road", "building", "pole", "vegetation"))
LIDAR_REACH_PX, HIDING_WINDOW_PX, HIDING_RATIO = 2.0, (7, 9), 1.15


class DepthTruth(Protocol):
    """What is known of depths in some frames of a log.

    frames  (M,) numbers of those frames
    reach   points hosted up to so many frames away are looked at
    """

    @property
    def frames(self) -> IntArray: ...

    @property
    def reach(self) -> int: ...

    def at(self, frame: int, uv: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
        """Depth (n,) m along z, NaN where unknown, and class (n,), 255 where unknown, at pixels uv (n, 2) of a left image."""
        ...


@dataclass(frozen=True, slots=True)
class TruthImages:
    """The truth folder that `wayloom simulate --truth` writes: depth and class of every pixel."""

    folder: Path
    frames: IntArray
    reach: int = 0

    @staticmethod
    def beside(log: DriveLog) -> "TruthImages | None":
        """Of a log's own truth folder; None where there is none."""
        folder = log.path / "truth"
        frames = sorted(int(file.stem) for file in (folder / "depth_left").glob("*.png"))
        return TruthImages(folder, np.array(frames, np.int64)) if frames else None

    def at(self, frame: int, uv: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
        """As of DepthTruth: the nearest pixel's."""
        depth = self._image("depth_left", frame) / DEPTH_PER_M
        u, v = np.rint(uv).astype(int).T
        classes = self._image("class_left", frame)
        return np.where(depth[v, u] > 0, depth[v, u], np.nan), classes[v, u].astype(np.uint8)

    def _image(self, kind: str, frame: int) -> NDArray[np.uint16]:
        file = self.folder / kind / f"{frame:06d}.png"
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise LogError("is no image", file=file, remedy="simulate the drive again")
        return np.asarray(image, np.uint16)


@dataclass(frozen=True, slots=True)
class LidarDepth:
    """Laser scans of a KITTI raw drive: the nearest return within 2 px that nothing hides from the camera."""

    files: dict[int, Path]
    T_cam_velo: FloatArray
    camera: PinholeCamera
    frames: IntArray
    reach: int = 3

    @staticmethod
    def of_kitti_raw(log: DriveLog, left: str = "02") -> "LidarDepth | None":
        """Of a drive's velodyne_points folder and the calibration beside it; None where either lacks."""
        files = {int(file.stem): file for file in sorted((log.path / "velodyne_points" / "data").glob("*.bin"))}
        places = (log.path, log.path.parent)
        found = [next((p / name for p in places if (p / name).is_file()), None) for name in (CAM_TO_CAM, VELO_TO_CAM)]
        if not files or found[0] is None or found[1] is None:
            return None
        cam_to_cam = read_calibration(found[0])
        T_rect = se3.from_rotation_translation(
            cam_to_cam.rotation("R_rect_00"), t_cam_reference(cam_to_cam.numbers(f"P_rect_{left}", 3, 4))
        )
        T_cam_velo = np.asarray(T_rect @ rigid_from(read_calibration(found[1])))
        return LidarDepth(files, T_cam_velo, log.rig.camera, np.array(sorted(files), np.int64))

    def at(self, frame: int, uv: FloatArray) -> tuple[FloatArray, NDArray[np.uint8]]:
        """As of DepthTruth; classes are unknown."""
        scan = np.fromfile(self.files[frame], np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        uv_lidar, z = self.visible_returns(se3.transform(self.T_cam_velo, scan))
        depth = np.full(len(uv), np.nan)
        for i, place in enumerate(uv):
            distance2 = ((uv_lidar - place) ** 2).sum(axis=1)
            nearest = int(np.argmin(distance2)) if len(distance2) else 0
            if len(distance2) and distance2[nearest] < LIDAR_REACH_PX**2:
                depth[i] = z[nearest]
        return depth, np.full(len(uv), VOID, np.uint8)

    def visible_returns(self, points_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) and depths (n,) m of the returns points_cam (N, 3) m that no much nearer one hides: the scanner stands
        higher than the camera and looks over things."""
        points_cam = points_cam[points_cam[:, 2] > 1.0]
        uv = self.camera.project(points_cam)
        inside = self.camera.contains(uv, 1.0)
        uv, z = uv[inside], points_cam[inside, 2]
        nearest = np.full((self.camera.height, self.camera.width), np.inf, np.float32)
        column, row = np.rint(uv).astype(int).T
        np.minimum.at(nearest, (row, column), z)
        around = cv2.erode(nearest, np.ones(HIDING_WINDOW_PX, np.uint8))
        seen = z < HIDING_RATIO * around[row, column]
        return uv[seen], z[seen]


@dataclass(frozen=True, slots=True)
class DepthErrors:
    """points compared; the shares of them within 5 % of the true depth up to 30 m, and more than 2 px of disparity off; of
    those on road, building, pole and vegetation up to 15 m away, the share within 10 cm; the median disparity error
    (estimate minus truth, px) in the middle of the image (|x| < 0.3) and at its sides. NaN where nothing could be compared."""

    points: int
    within_5_percent: float
    beyond_2_px: float
    surface_within_10_cm: float
    median_px_centre: float
    median_px_sides: float


def compared_depths(
    result: OdometryResult, truth: DepthTruth, numbers: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.uint8]]:
    """Every point seen from the frames that truth knows: x (n,) normalised, estimated and true depth (n,) m, class (n,).

    numbers : (N,) the trajectory's frames as truth numbers them. A point is looked at from the frames up to truth.reach from
    its host's.
    """
    found: list[tuple[FloatArray, FloatArray, FloatArray, NDArray[np.uint8]]] = []
    p, camera = result.points, result.rig.camera
    p_host = camera.rays(p.uv_host.astype(np.float64)) / np.maximum(p.inverse_depth.astype(np.float64), 1e-9)[:, None]
    host_number = numbers[result.keyframes.frame[p.host]] if len(p) else np.zeros(0, np.int64)
    for frame in np.flatnonzero(np.isin(numbers, truth.frames)):
        mine = np.flatnonzero(np.abs(host_number - numbers[frame]) <= truth.reach)
        T_frame_host = se3.inverse(result.trajectory.T_world_cam[frame]) @ result.keyframes.T_world_cam[p.host[mine]]
        p_frame = np.einsum("nij,nj->ni", T_frame_host[:, :3, :3], p_host[mine]) + T_frame_host[:, :3, 3]
        uv = camera.project(p_frame)
        inside = camera.contains(uv)
        depth, classes = truth.at(int(numbers[frame]), uv[inside])
        x = p_frame[inside, 0] / p_frame[inside, 2]
        found.append((x, p_frame[inside, 2], depth, classes))
    if not found:
        return np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.uint8)
    x, estimate, depth, classes = (np.concatenate(column) for column in zip(*found, strict=True))
    known = np.isfinite(depth)
    return x[known], estimate[known], depth[known], classes[known].astype(np.uint8)


def depth_errors(result: OdometryResult, truth: DepthTruth, numbers: IntArray) -> DepthErrors:
    """The errors of a result's points against truth; numbers as of `compared_depths`."""
    x, estimate, depth, classes = compared_depths(result, truth, numbers)
    disparity_px = result.rig.bf * (1.0 / estimate - 1.0 / depth)
    near, centre = depth <= NEAR_M, np.abs(x) < CENTRE_X
    surface = np.isin(classes, SURFACES) & (depth <= SURFACE_M)
    return DepthErrors(
        len(depth),
        _share((np.abs(estimate - depth) < RELATIVE_ERROR * depth)[near]),
        _share(np.abs(disparity_px) > DISPARITY_ERROR_PX),
        _share((np.abs(estimate - depth) < SURFACE_ERROR_M)[surface]),
        _median(disparity_px[centre]),
        _median(disparity_px[~centre]),
    )


def _share(hits: NDArray[np.bool_]) -> float:
    return float(hits.mean()) if len(hits) else float("nan")


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")
