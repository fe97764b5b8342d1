"""Exports of a processed drive for people and other programs: trajectory, cloud, overlay pictures, map picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.exports.drive_origin import drive_origin
from wayloom.exports.las import projection_at
from wayloom.exports.laz import write_laz
from wayloom.exports.ply import write_ply
from wayloom.exports.points import batch_of_submap
from wayloom.exports.provenance import provenance_of
from wayloom.exports.track import export_geojson_track
from wayloom.files.trajectory_files import write_kitti, write_tum
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.geodesy.map_frame import MapFrame
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
    _write_clouds(submaps, folder, geo.frame, geoid, {} if ground is None else drive_origin(ground.sheets_dir.parent, log.name))
    if ground is not None:
        export_ground(ground.sheets_dir, submaps, folder)
        export_markings(ground.sheets_dir, submaps, folder / MARKINGS_FILE, ground.markings, ground.kerbs)
        if geo.frame is not None:
            export_objects(ground.objects, geo.frame, folder / OBJECTS_FILE)
    write_image(folder / MAP_FILE, drive_map(geo, points, labels))
    write_overlays(log, odometry, images, folder / OVERLAYS_DIR)


def _write_clouds(
    submaps: list[PlacedSubmap], folder: Path, frame: MapFrame | None, geoid: GeoidGrid | None, origin: dict[str, Any]
) -> None:
    """All points of all submaps, moving things included; the PLY near the drive's start, up as up."""
    place = submaps[0].T_enu_submap[:3, 3] if submaps else np.zeros(3)
    write_ply(folder / "cloud.ply", map(batch_of_submap, submaps), place, frame)
    provenance = provenance_of("one drive's points", [origin], frame, {}, "")
    write_laz(folder / "cloud.laz", map(batch_of_submap, submaps), projection_at(place, frame, geoid), provenance)


def write_overlays(log: DriveLog, odometry: OdometryResult, images: KeyframeLabels, folder: Path, count: int = OVERLAYS) -> None:
    """`%010d_left.jpg` and `%010d_right.jpg`, named by frame, of keyframes spread evenly over the drive."""
    folder.mkdir()
    rows = np.unique(np.linspace(0, len(odometry.keyframes) - 1, count).round().astype(np.int64))
    for row in rows.tolist():
        frame = log.frame(int(odometry.keyframes.frame[row]))
        write_image(folder / f"{frame.index:010d}_left.jpg", overlay(frame.left, images.left(row)))
        write_image(folder / f"{frame.index:010d}_right.jpg", overlay(frame.right, images.right(row)))
