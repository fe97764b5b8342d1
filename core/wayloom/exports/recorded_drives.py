"""Drives of a map as recordings: poses in time, places on Earth, label images, for formats that are played back."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.errors import InputError
from wayloom.exports.city_survey import level_plane
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.points import PointBatch, joined_batches, map_batches
from wayloom.exports.source import MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geometry import se3
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry

FloatArray = NDArray[np.float64]
LABELS: Final = "segmentation/left"


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A drive in the map's level frame: x east, y north, z up of its middle (without GNSS: right, ahead, up of the start).

    t_ns (N,) stamps; T_map_cam (N, 4, 4) of the left camera; lon_lat_height (N, 3) and covariance_enu (N, 3, 3) m² of its place,
    None without GNSS; label_images: of keyframes, frame and file of train ids, by frame
    """

    name: str
    t_ns: NDArray[np.int64]
    T_map_cam: FloatArray
    lon_lat_height: FloatArray | None
    covariance_enu: FloatArray | None
    label_images: tuple[tuple[int, Path], ...]

    def pictures(self) -> Iterator[tuple[int, bytes]]:
        """Frame and PNG of each label image in the colours of the classes."""
        for frame, file in self.label_images:
            labels = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_UNCHANGED)
            if labels is not None:
                yield frame, cv2.imencode(".png", np.ascontiguousarray(PALETTE_WITH_VOID[labels][..., ::-1]))[1].tobytes()


def recorded_drives(source: MapSource, out: Path) -> list[RecordedDrive]:
    """The drives of a map. Raises InputError for a map that is not made of folders of `wayloom process`."""
    if not isinstance(source, DriveOutputs):
        raise InputError("needs poses in time, which a service's map has not", file=out, remedy="export folders of drives")
    T_map_frame = level_plane(source)[0]
    return [_recorded(source, stages, name, T_map_frame) for name, stages in source.stages().items()]


def map_points(source: MapSource, box: Box | None) -> PointBatch:
    """The static voxels in the level frame."""
    found = joined_batches([*map_batches(source, box)])
    T_map_frame, points = level_plane(source)[0], found.points
    columns = (getattr(found, name) for name in PointBatch.__slots__ if name != "points")
    return PointBatch(se3.transform(T_map_frame, points), *columns)


def _recorded(source: DriveOutputs, stages: Path, name: str, T_map_frame: FloatArray) -> RecordedDrive:
    geo = load_georeference(stages / "georeference" / GEOREFERENCE_FILE)
    trajectory = load_odometry(stages / "odometry" / ODOMETRY_FILE).trajectory
    T_map_enu, places, covariance = T_map_frame, None, None
    if geo.frame is not None and source.frame is not None:
        T_map_enu = T_map_frame @ wgs84.T_enu_enu(source.frame, geo.frame)
        places = wgs84.lonlatheight_from_enu(geo.T_enu_cam[:, :3, 3], geo.frame)
        R = T_map_enu[:3, :3]
        covariance = R @ position_covariance(geo.T_enu_cam, geo.covariance) @ R.T
    files = sorted((stages / LABELS).glob("*.png")) if (stages / LABELS).is_dir() else []
    images = tuple((int(file.stem), file) for file in files if file.stem.isdecimal())
    return RecordedDrive(name, trajectory.t_ns, T_map_enu @ geo.T_enu_cam, places, covariance, images)
