"""Exports of a processed drive for people and other programs: trajectory, cloud, overlay pictures, map picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.dense.points import dense_points
from wayloom.dense.settings import LookSettings
from wayloom.files.trajectory_files import write_kitti, write_tum
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference
from wayloom.ground.exports import export_ground
from wayloom.ground.markings.exports import MARKINGS_FILE, export_markings
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.drive_map import cloud, drive_map, write_image
from wayloom.places.stereo_pair import LeftLabels
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.overlay import overlay
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.exports import export_geojson_track, export_laz, export_ply

MAP_FILE: Final = "map.png"
DENSE_FILE: Final = "dense.laz"
OVERLAYS_DIR: Final = "overlays"
OVERLAYS: Final = 6


@dataclass(frozen=True, slots=True)
class GroundFound:
    """Folder of what the stage ground left, and how markings and kerbs are found on it."""

    sheets_dir: Path
    markings: MarkingSettings
    kerbs: KerbSettings


def write_exports(
    log: DriveLog,
    odometry: OdometryResult,
    images: KeyframeLabels,
    geo: GeoReference,
    submaps: list[PlacedSubmap],
    folder: Path,
    geoid: GeoidGrid | None = None,
    ground: GroundFound | None = None,
) -> None:
    """Write trajectory.tum, .kitti and, with GNSS, .geojson; cloud.ply and cloud.laz; ground.tif, height.tif and, with GNSS,
    markings.geojson; map.png; overlays/.

    geoid : the LAZ states heights above it
    ground : None for no pictures of the ground
    """
    trajectory = odometry.trajectory
    write_tum(folder / "trajectory.tum", trajectory.t_ns, trajectory.T_world_cam, trajectory.tracked)
    write_kitti(folder / "trajectory.kitti", trajectory.T_world_cam)
    if geo.frame is not None:
        export_geojson_track(folder / "trajectory.geojson", geo.T_enu_cam, geo.frame, log.name)
    points, labels = cloud(submaps)
    export_ply(folder / "cloud.ply", points, labels, geo.frame)
    export_laz(folder / "cloud.laz", points, labels, geo.frame, geoid)
    if ground is not None:
        export_ground(ground.sheets_dir, submaps, folder)
        export_markings(ground.sheets_dir, submaps, folder / MARKINGS_FILE, ground.markings, ground.kerbs)
    write_image(folder / MAP_FILE, drive_map(geo, points, labels))
    write_overlays(log, odometry, images, folder / OVERLAYS_DIR)


def write_dense(
    log: DriveLog,
    odometry: OdometryResult,
    images: LeftLabels,
    submaps: list[PlacedSubmap],
    file: Path,
    frame: MapFrame | None,
    geoid: GeoidGrid | None,
    settings: LookSettings,
) -> None:
    """The dense points of all submaps, each at its place, as `cloud.laz` has the sparse ones."""
    found = list(dense_points(log, odometry, images, [placed.submap for placed in submaps], settings))
    points = [se3.transform(placed.T_enu_submap, one.xyz) for placed, one in zip(submaps, found, strict=True)]
    labels = np.concatenate([np.empty(0, np.uint8), *(one.label for one in found)])
    export_laz(file, np.concatenate([np.empty((0, 3)), *points]), labels, frame, geoid)


def write_overlays(log: DriveLog, odometry: OdometryResult, images: KeyframeLabels, folder: Path, count: int = OVERLAYS) -> None:
    """`%010d_left.jpg` and `%010d_right.jpg`, named by frame, of keyframes spread evenly over the drive."""
    folder.mkdir()
    rows = np.unique(np.linspace(0, len(odometry.keyframes) - 1, count).round().astype(np.int64))
    for row in rows.tolist():
        frame = log.frame(int(odometry.keyframes.frame[row]))
        write_image(folder / f"{frame.index:010d}_left.jpg", overlay(frame.left, images.left(row)))
        write_image(folder / f"{frame.index:010d}_right.jpg", overlay(frame.right, images.right(row)))
