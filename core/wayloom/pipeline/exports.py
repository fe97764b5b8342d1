"""Exports of a processed drive for people and other programs: trajectory, cloud, overlay pictures, map picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.files.trajectory_files import write_kitti, write_tum
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.georeference.types import GeoReference
from wayloom.ground.exports import export_ground
from wayloom.ground.markings.exports import MARKINGS_FILE, export_markings
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.logs.types import DriveLog
from wayloom.objects.exports import OBJECTS_FILE, export_objects
from wayloom.objects.types import MapObject
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.drive_map import cloud, drive_map, write_image
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.overlay import overlay
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.exports import export_geojson_track, export_laz, export_ply

MAP_FILE: Final = "map.png"
OVERLAYS_DIR: Final = "overlays"
OVERLAYS: Final = 6


@dataclass(frozen=True, slots=True)
class GroundFound:
    """Folder of what the stage ground left, how markings and kerbs are found on it, and the objects that stand on it."""

    sheets_dir: Path
    markings: MarkingSettings
    kerbs: KerbSettings
    objects: Sequence[MapObject] = ()


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
    markings.geojson and objects.geojson; map.png; overlays/.

    geoid : the LAZ states heights above it
    ground : None for neither pictures of the ground nor objects
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
        if geo.frame is not None:
            export_objects(ground.objects, geo.frame, folder / OBJECTS_FILE)
    write_image(folder / MAP_FILE, drive_map(geo, points, labels))
    write_overlays(log, odometry, images, folder / OVERLAYS_DIR)


def write_overlays(log: DriveLog, odometry: OdometryResult, images: KeyframeLabels, folder: Path, count: int = OVERLAYS) -> None:
    """`%010d_left.jpg` and `%010d_right.jpg`, named by frame, of keyframes spread evenly over the drive."""
    folder.mkdir()
    rows = np.unique(np.linspace(0, len(odometry.keyframes) - 1, count).round().astype(np.int64))
    for row in rows.tolist():
        frame = log.frame(int(odometry.keyframes.frame[row]))
        write_image(folder / f"{frame.index:010d}_left.jpg", overlay(frame.left, images.left(row)))
        write_image(folder / f"{frame.index:010d}_right.jpg", overlay(frame.right, images.right(row)))
