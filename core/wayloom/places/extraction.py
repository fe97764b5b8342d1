"""Extraction of a drive's places from its images: one pass over the keyframes that are chosen along the road."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.files.growing_arrays import GrowingTable, forget_pages
from wayloom.geometry import se3
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.birds_eye import SHAPE, birds_eye
from wayloom.places.cloud import HostedCloud, VoxelFilter, no_cloud, pair_points, taken
from wayloom.places.features import BYTES, describe
from wayloom.places.road import road_m, spaced
from wayloom.places.settings import PlaceSettings
from wayloom.places.stereo_pair import LeftLabels, read_pair, right_rectifier
from wayloom.places.types import PlaceCloud, PlaceFeatures, Places, PlaceStations
from wayloom.places.views import view_at

FloatArray = NDArray[np.float64]
STATIONS_AT_ONCE: Final = 64
"""What a long drive's stations have looked at stays in memory for so many of them."""


def make_places(
    log: DriveLog,
    odometry: OdometryResult,
    hosted: HostedCloud,
    images: LeftLabels,
    settings: PlaceSettings = PlaceSettings(),
    progress: Progress = silent,
    threads: int = 1,
) -> Places:
    """What is kept of the drive's places, from the images of so many keyframes at a time.

    odometry : its points are not asked for
    hosted   : of `hosted_points`
    Raises StageError where an image's labels are missing, LogError as the log.
    """
    keyframes, road = odometry.keyframes, road_m(odometry.keyframes.T_world_cam)
    described = spaced(road, keyframes.segment, settings.feature_spacing_m)
    matched = spaced(road, keyframes.segment, settings.cloud_spacing_m)
    rectifier, voxels = right_rectifier(odometry), VoxelFilter(settings.voxel_m, settings.reach_m)
    features, cloud = GrowingTable(_no_features()), GrowingTable(no_cloud())

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
            cloud.append(_kept(voxels, hosted.of_keyframe(k), keyframes.T_world_cam[k], road[k]))
            if of_pair is not None:
                features.append(of_pair)
            if more is not None:
                cloud.append(_kept(voxels, more, keyframes.T_world_cam[k], road[k]))
            progress(k / len(keyframes), f"keyframe {k + 1} of {len(keyframes)}")
    c = odometry.rig.camera
    camera = (float(c.fx), float(c.fy), float(c.cx), float(c.cy), int(c.width), int(c.height))
    places = Places(keyframes.T_world_cam, keyframes.segment, camera, features.table(), cloud.table())
    return replace(places, stations=make_stations(places, settings))


def make_stations(places: Places, settings: PlaceSettings) -> PlaceStations:
    """The stations of places that have none yet."""
    rows = np.flatnonzero(spaced(road_m(places.T_world_keyframe), places.segment, settings.station_spacing_m)).astype(np.int32)
    grids = np.empty((len(rows), *SHAPE), np.uint8)
    for station, k in enumerate(rows.tolist()):
        grids[station] = birds_eye(view_at(places, k, settings.reach_m))
        if station % STATIONS_AT_ONCE == 0:
            for column in (places.cloud.p_cam, places.features.bits, places.features.p_cam):
                forget_pages(column)
    return PlaceStations(rows, grids)


def _kept(voxels: VoxelFilter, cloud: PlaceCloud, T_world_cam: FloatArray, road: float) -> PlaceCloud:
    points = se3.transform(T_world_cam, 0.01 * cloud.p_cam.astype(np.float64))
    return taken(cloud, voxels.rows(points, cloud.sigma_cm, float(road)))


def _no_features() -> PlaceFeatures:
    none = np.zeros(0, np.float32)
    return PlaceFeatures(np.zeros(0, np.int32), np.zeros((0, BYTES), np.uint8), none.reshape(0, 2), none.reshape(0, 3), none)
