"""Exports of a processed drive for people and other programs: trajectory, cloud, overlay pictures, map picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.dense.points import DensePoints, dense_points
from wayloom.dense.settings import LookSettings
from wayloom.exports.drive_origin import drive_origin
from wayloom.exports.las import projection_at
from wayloom.exports.laz import write_laz
from wayloom.exports.ply import write_ply
from wayloom.exports.points import ALL_VOTES, PointBatch, batch_of_submap
from wayloom.exports.provenance import provenance_of
from wayloom.exports.track import export_geojson_track
from wayloom.files.trajectory_files import write_kitti, write_tum
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference
from wayloom.logs.types import DriveLog
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.drive_map import drive_map, write_image
from wayloom.places.stereo_pair import LeftLabels
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.overlay import overlay, without_persons
from wayloom.submaps.submap import PlacedSubmap

MAP_FILE: Final = "map.png"
DENSE_FILE: Final = "dense.laz"
OVERLAYS_DIR: Final = "overlays"
OVERLAYS: Final = 6


def write_exports(
    log: DriveLog,
    odometry: OdometryResult,
    images: KeyframeLabels,
    geo: GeoReference,
    submaps: Sequence[PlacedSubmap],
    folder: Path,
    geoid: GeoidGrid | None = None,
    stages_dir: Path | None = None,
) -> None:
    """Write trajectory.tum, .kitti and, with GNSS, .geojson; cloud.ply and cloud.laz; map.png; overlays/.

    geoid : the LAZ states heights above it
    stages_dir : the drive's stages, of which the LAZ tells where its points are from
    """
    trajectory = odometry.trajectory
    write_tum(folder / "trajectory.tum", trajectory.t_ns, trajectory.T_world_cam, trajectory.tracked)
    write_kitti(folder / "trajectory.kitti", trajectory.T_world_cam)
    if geo.frame is not None:
        export_geojson_track(folder / "trajectory.geojson", geo.T_enu_cam, geo.frame, log.name)
    _write_clouds(submaps, folder, geo.frame, geoid, {} if stages_dir is None else drive_origin(stages_dir, log.name, "submaps"))
    write_image(folder / MAP_FILE, drive_map(geo, submaps))
    write_overlays(log, odometry, images, folder / OVERLAYS_DIR)


def _write_clouds(
    submaps: Sequence[PlacedSubmap], folder: Path, frame: MapFrame | None, geoid: GeoidGrid | None, origin: dict[str, Any]
) -> None:
    """All points of all submaps, vehicles included; the PLY near the drive's start, up as up."""
    place = submaps[0].T_enu_submap[:3, 3] if submaps else np.zeros(3)
    write_ply(folder / "cloud.ply", map(batch_of_submap, submaps), place, frame)
    provenance = provenance_of("one drive's points", [origin], frame, {}, "")
    write_laz(folder / "cloud.laz", map(batch_of_submap, submaps), projection_at(place, frame, geoid), provenance)


def write_dense(
    log: DriveLog,
    odometry: OdometryResult,
    images: LeftLabels,
    submaps: Sequence[PlacedSubmap],
    file: Path,
    frame: MapFrame | None,
    geoid: GeoidGrid | None,
    settings: LookSettings,
) -> None:
    """The dense points of all submaps, each at its place, as `cloud.laz` has the sparse ones: without grey values and sigmas."""
    place = submaps[0].T_enu_submap[:3, 3] if submaps else np.zeros(3)
    provenance = provenance_of("one drive's dense points", [], frame, {}, "")
    found = dense_points(log, odometry, images, (placed.submap for placed in submaps), settings)
    batches = (_dense_batch(placed, one) for placed, one in zip(submaps, found, strict=True))
    write_laz(file, batches, projection_at(place, frame, geoid), provenance)


def _dense_batch(placed: PlacedSubmap, found: DensePoints) -> PointBatch:
    count, t_ns = len(found.xyz), placed.submap.keyframe_t_ns
    return PointBatch(
        se3.transform(placed.T_enu_submap, found.xyz), found.label, np.zeros(count, np.uint8), np.full(count, np.nan, np.float32),
        np.full(count, ALL_VOTES, np.uint8), np.ones(count, np.uint16), np.full(count, t_ns[0]), np.full(count, t_ns[-1]),
    )  # fmt: skip


def write_overlays(log: DriveLog, odometry: OdometryResult, images: KeyframeLabels, folder: Path, count: int = OVERLAYS) -> None:
    """`%010d_left.jpg` and, if labelled, `%010d_right.jpg`, by frame, of keyframes spread evenly; persons are painted over."""
    folder.mkdir()
    rows = np.unique(np.linspace(0, len(odometry.keyframes) - 1, count).round().astype(np.int64))
    for row in rows.tolist():
        frame = log.frame(int(odometry.keyframes.frame[row]))
        for side in images.sides(row):
            image, labels = (frame.left, images.left(row)) if side == "left" else (frame.right, images.right(row))
            picture = overlay(without_persons(image, labels), labels)
            write_image(folder / f"{frame.index:010d}_{side}.jpg", picture)
