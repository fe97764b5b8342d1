"""What a processed drive leaves for people and other programs: trajectory, cloud, overlay pictures, map picture."""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.files.trajectory_files import write_kitti, write_tum
from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.plane import T_plane_enu
from wayloom.segmentation.overlay import overlay
from wayloom.segmentation.stage import KeyframeLabels
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.exports import export_geojson_track, export_laz, export_ply
from wayloom.tiles.preview import top_down

MAP_FILE: Final = "map.png"
OVERLAYS_DIR: Final = "overlays"
OVERLAYS: Final = 6
JPEG_QUALITY: Final = 90


def write_exports(
    log: DriveLog,
    odometry: OdometryResult,
    images: KeyframeLabels,
    geo: GeoReference,
    submaps: list[PlacedSubmap],
    folder: Path,
) -> None:
    """Write trajectory.tum, .kitti and, with GNSS, .geojson; cloud.ply and cloud.laz; map.png; overlays/."""
    trajectory = odometry.trajectory
    write_tum(folder / "trajectory.tum", trajectory.t_ns, trajectory.T_world_cam)
    write_kitti(folder / "trajectory.kitti", trajectory.T_world_cam)
    if geo.frame is not None:
        export_geojson_track(folder / "trajectory.geojson", geo.T_enu_cam, geo.frame, log.name)
    points, labels = cloud(submaps)
    export_ply(folder / "cloud.ply", points, labels, geo.frame)
    export_laz(folder / "cloud.laz", points, labels, geo.frame)
    write_image(folder / MAP_FILE, drive_map(geo, points, labels))
    write_overlays(log, odometry, images, folder / OVERLAYS_DIR)


def drive_map(geo: GeoReference, points: NDArray[np.float64], labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w, 3) RGB: the drive from above, with its track. points (N, 3) m and labels (N,) are those of `cloud`."""
    T = T_plane_enu(geo)
    track = se3.transform(T, geo.T_enu_cam[:, :3, 3])
    return top_down(se3.transform(T, points), labels, tracks_enu=(track,), north_up=geo.frame is not None)


def cloud(submaps: list[PlacedSubmap]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """points (N, 3) m in the map's frame, or the drive's own, and labels (N,) of all submaps."""
    points = np.concatenate([np.empty((0, 3)), *(placed.points_enu() for placed in submaps)])
    labels = np.concatenate([np.empty(0, np.uint8), *(placed.submap.label for placed in submaps)])
    return points, labels


def write_overlays(log: DriveLog, odometry: OdometryResult, images: KeyframeLabels, folder: Path, count: int = OVERLAYS) -> None:
    """`%010d_left.jpg` and `%010d_right.jpg`, named by frame, of keyframes spread evenly over the drive."""
    folder.mkdir()
    rows = np.unique(np.linspace(0, len(odometry.keyframes) - 1, count).round().astype(np.int64))
    for row in rows.tolist():
        frame = log.frame(int(odometry.keyframes.frame[row]))
        write_image(folder / f"{frame.index:010d}_left.jpg", overlay(frame.left, images.left(row)))
        write_image(folder / f"{frame.index:010d}_right.jpg", overlay(frame.right, images.right(row)))


def write_image(file: Path, image: NDArray[np.uint8]) -> None:
    """An RGB image (h, w, 3) as PNG or JPEG, by the file's suffix."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if file.suffix == ".jpg" else []
    written, data = cv2.imencode(file.suffix, np.ascontiguousarray(image[:, :, ::-1]), options)
    if not written:
        raise StageError(f"{file}: an image of {image.shape} could not be encoded")
    file.write_bytes(data.tobytes())


def read_image(file: Path) -> NDArray[np.uint8]:
    """(h, w, 3) RGB. Raises StageError where the file is no image."""
    image = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise StageError(f"{file}: no readable image; run the drive again")
    return np.asarray(image[:, :, ::-1], dtype=np.uint8)
