"""Extraction of a drive's places from its images: one pass over the keyframes that are chosen along the road."""

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.labelling.types import PointLabels
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.birds_eye import SHAPE, birds_eye
from wayloom.places.cloud import VoxelFilter, hosted_points, packed, pair_points, taken
from wayloom.places.features import BYTES, describe
from wayloom.places.road import road_m, spaced
from wayloom.places.settings import PlaceSettings
from wayloom.places.stereo_pair import LeftLabels, read_pair, right_rectifier
from wayloom.places.types import PlaceCloud, PlaceFeatures, Places, PlaceStations
from wayloom.places.views import view_at

FloatArray = NDArray[np.float64]
Table = TypeVar("Table", PlaceCloud, PlaceFeatures)


def make_places(
    log: DriveLog,
    odometry: OdometryResult,
    labels: PointLabels,
    images: LeftLabels,
    settings: PlaceSettings = PlaceSettings(),
    progress: Progress = silent,
    threads: int = 1,
) -> Places:
    """What is kept of the drive's places, from the images of so many keyframes at a time.

    Raises StageError when labels and points do not belong together, LogError as the log.
    """
    if len(labels) != len(odometry.points):
        raise StageError(f"{len(labels)} labels for {len(odometry.points)} points: labelling and odometry are of different runs")
    keyframes, road = odometry.keyframes, road_m(odometry.keyframes.T_world_cam)
    described = spaced(road, keyframes.segment, settings.feature_spacing_m)
    matched = spaced(road, keyframes.segment, settings.cloud_spacing_m)
    start, hosted = hosted_points(odometry, labels, settings)
    rectifier, voxels = right_rectifier(odometry), VoxelFilter(settings.voxel_m, settings.reach_m)
    features, clouds = [_no_features()], [_no_cloud()]

    def seen(k: int) -> tuple[PlaceFeatures | None, PlaceCloud | None]:
        if not (described[k] or matched[k]):
            return None, None
        pair = read_pair(log, int(keyframes.frame[k]), images.left(k), rectifier)
        return (
            describe(pair, k, odometry, settings) if described[k] else None,
            pair_points(pair, k, odometry, settings) if matched[k] else None,
        )

    with one_opencv_thread():
        for k, (of_pair, more) in enumerate(in_order(seen, range(len(keyframes)), threads)):
            clouds.append(_kept(voxels, taken(hosted, slice(start[k], start[k + 1])), keyframes.T_world_cam[k], road[k]))
            features += [] if of_pair is None else [of_pair]
            clouds += [] if more is None else [_kept(voxels, more, keyframes.T_world_cam[k], road[k])]
            progress(k / len(keyframes), f"keyframe {k + 1} of {len(keyframes)}")
    c = odometry.rig.camera
    camera = (float(c.fx), float(c.fy), float(c.cx), float(c.cy), int(c.width), int(c.height))
    places = Places(keyframes.T_world_cam, keyframes.segment, camera, joined(features), joined(clouds))
    return replace(places, stations=make_stations(places, settings))


def make_stations(places: Places, settings: PlaceSettings) -> PlaceStations:
    """The stations of places that have none yet."""
    rows = np.flatnonzero(spaced(road_m(places.T_world_keyframe), places.segment, settings.station_spacing_m)).astype(np.int32)
    return PlaceStations(rows, np.array([birds_eye(view_at(places, int(k), settings.reach_m)) for k in rows]).reshape(-1, *SHAPE))


def joined(parts: list[Table]) -> Table:
    """The tables (one at least) one behind the other. Takes them out of `parts`: no more than a column is in memory twice."""
    table = type(parts[0])
    waiting: dict[str, list[Any]] = {f.name: [getattr(part, f.name) for part in parts] for f in fields(table)}
    parts.clear()
    columns: dict[str, Any] = {f.name: np.concatenate(waiting.pop(f.name)) for f in fields(table)}
    return table(**columns)


def _kept(voxels: VoxelFilter, cloud: PlaceCloud, T_world_cam: FloatArray, road: float) -> PlaceCloud:
    points = se3.transform(T_world_cam, 0.01 * cloud.p_cam.astype(np.float64))
    return taken(cloud, voxels.rows(points, cloud.sigma_cm, float(road)))


def _no_cloud() -> PlaceCloud:
    return packed(np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0))


def _no_features() -> PlaceFeatures:
    none = np.zeros(0, np.float32)
    return PlaceFeatures(np.zeros(0, np.int32), np.zeros((0, BYTES), np.uint8), none.reshape(0, 2), none.reshape(0, 3), none)
