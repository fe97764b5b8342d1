"""What a drive leaves can be read by others and lies where it should."""

import json
import subprocess
import sys

import cv2
import laspy
import numpy as np
import pytest
from evo.tools import file_interface

from made_ground import BuiltUpStreet
from reports.made_result import CAMERA, made_result
from wayloom.config.classes import CLASS_ID, PALETTE_WITH_VOID
from wayloom.dense.points import dense_points
from wayloom.dense.settings import LookSettings
from wayloom.files.gps_time import adjusted_gps_s
from wayloom.files.ply import read_ply
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import T_enu_enu, enu_from_lonlatheight
from wayloom.geometry import se3
from wayloom.pipeline.drive_map import PlacedPoints
from wayloom.pipeline.exports import write_dense, write_exports, write_overlays
from wayloom.pipeline.plane import T_plane_enu, axis_labels
from wayloom.reports.drive_report import overlays


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return made_result(tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    write_exports(result.log, result.odometry, result.images, result.geo, result.submaps, out)
    return out


def test_evo_reads_both_trajectories(folder, result):
    tum = file_interface.read_tum_trajectory_file(str(folder / "trajectory.tum"))
    kitti = file_interface.read_kitti_poses_file(str(folder / "trajectory.kitti"))
    T = result.odometry.trajectory.T_world_cam
    np.testing.assert_allclose(tum.positions_xyz, T[:, :3, 3], atol=1e-8)
    np.testing.assert_allclose(kitti.poses_se3, T, atol=1e-8)
    np.testing.assert_allclose(tum.timestamps, result.odometry.trajectory.t_ns * 1e-9, atol=1e-9)


def test_the_geojson_track_lies_where_the_fixes_are(folder, result):
    line = json.loads((folder / "trajectory.geojson").read_text())["features"][0]["geometry"]
    assert line["type"] == "LineString"
    frame = MapFrame(8.4, 49.0, 117.0)
    mapped = enu_from_lonlatheight(np.array(line["coordinates"]), frame)
    fixes = enu_from_lonlatheight(result.log.gnss.lon_lat_height, frame)
    assert len(mapped) == 30
    assert np.hypot(*(mapped - fixes)[:, :2].T).max() < 0.5
    np.testing.assert_allclose(fixes[:, 2] - mapped[:, 2], 1.0, atol=0.2)  # the antenna is 1 m above the camera


def test_the_cloud_has_all_points_of_all_submaps_with_their_colours(folder, result):
    ply = read_ply(folder / "cloud.ply")
    points, labels = map(np.concatenate, zip(*PlacedPoints(result.submaps, np.eye(4)), strict=True))
    origin = (folder / "cloud.ply").read_bytes()[:300].split(b"ENU at ")[1].split(b" (")[0].split()
    T_local_enu = T_enu_enu(MapFrame(*map(float, origin)), result.geo.frame)
    np.testing.assert_allclose(ply.points, se3.transform(T_local_enu, points), atol=1e-9)
    assert np.linalg.norm(ply.points, axis=1).max() < 200.0  # near its origin, though the map's is 56 km away
    np.testing.assert_array_equal(ply.labels, labels)
    np.testing.assert_array_equal(ply.colours, PALETTE_WITH_VOID[labels])


def test_the_laz_has_the_same_points_in_utm(folder, result):
    laz = laspy.read(folder / "cloud.laz")
    labels = np.concatenate([item.submap.label for item in result.submaps])
    np.testing.assert_array_equal(np.asarray(laz.label), labels)
    assert laz.header.parse_crs().to_epsg() == 32632
    assert 450_000 < np.asarray(laz.x).mean() < 460_000
    grey = np.concatenate([item.submap.grey for item in result.submaps])
    sigma = np.sqrt(np.concatenate([item.submap.variance for item in result.submaps]))
    np.testing.assert_array_equal(np.asarray(laz.intensity), grey.astype(int) * 257)
    np.testing.assert_allclose(np.asarray(laz.sigma), sigma, atol=0.0005)
    seen_ns = np.concatenate([item.submap.seen_ns for item in result.submaps])
    np.testing.assert_array_equal(np.asarray(laz.gps_time), adjusted_gps_s(seen_ns))


def test_dense_points_of_all_submaps_are_in_one_laz_each_at_its_place(tmp_path):
    street = BuiltUpStreet()
    submaps, odometry = street.submaps(2), street.odometry()
    write_dense(street, odometry, street, submaps, tmp_path / "dense.laz", None, None, LookSettings())
    cloud = laspy.read(tmp_path / "dense.laz")
    found = list(dense_points(street, odometry, street, [item.submap for item in submaps]))
    enu = np.concatenate([se3.transform(item.T_enu_submap, one.xyz) for item, one in zip(submaps, found, strict=True)])
    assert len(enu) > 500
    np.testing.assert_allclose(cloud.xyz, enu, atol=0.001)
    assert set(np.unique(cloud.label).tolist()) == {CLASS_ID["building"]}


def test_overlays_are_spread_over_the_drive_and_of_the_cameras_size(folder):
    left = sorted(file.name for file in (folder / "overlays").glob("*_left.jpg"))
    assert left == [f"{frame:010d}_left.jpg" for frame in range(0, 30, 5)]
    assert len(list((folder / "overlays").iterdir())) == 12
    assert cv2.imread(str(folder / "overlays" / left[0])).shape == (CAMERA.height, CAMERA.width, 3)


def test_a_right_image_that_was_not_labelled_is_in_no_overlay_and_no_report(tmp_path):
    result = made_result(tmp_path)
    for row in (1, 2, 3, 4, 5):
        next(tmp_path.rglob(f"right/{5 * row:010d}.png")).unlink()
    write_overlays(result.log, result.odometry, result.images, tmp_path / "overlays")
    assert [path.name for path in (tmp_path / "overlays").glob("*_right.jpg")] == ["0000000000_right.jpg"]
    assert len(list((tmp_path / "overlays").glob("*_left.jpg"))) == 6
    captions = [picture.caption for picture in overlays(result, tmp_path)]
    assert captions == ["frame 0, 0.0 s, left", "right", *(f"frame {5 * row}, {0.5 * row} s, left" for row in (1, 2, 3, 4, 5))]


def test_the_plane_of_a_geo_referenced_drive_starts_at_its_first_camera_with_up_up(result):
    T = T_plane_enu(result.geo)
    track = se3.transform(T, result.geo.T_enu_cam[:, :3, 3])
    np.testing.assert_allclose(track[0], 0.0, atol=1e-6)
    assert np.abs(track[:, 2]).max() < 0.3  # the drive is level, though the map's plane stands 0.5 degrees askew there
    assert track[-1, 1] > 55
    assert axis_labels(result.geo) == ("east", "north")


def test_the_plane_of_a_drive_of_its_own_looks_ahead(tmp_path):
    result = made_result(tmp_path, gnss=False)
    track = se3.transform(T_plane_enu(result.geo), result.geo.T_enu_cam[:, :3, 3])
    assert track[-1, 1] > 55
    assert track[-1, 0] > 5
    assert np.abs(track[:, 2]).max() < 0.1  # level is what the cameras are in the mean
    assert axis_labels(result.geo) == ("right of the start", "ahead of the start")


def test_a_process_that_maps_a_drive_starts_without_what_makes_maps_of_fleets_and_what_writes_products():
    told = subprocess.run(
        [sys.executable, "-c", "import sys, wayloom.pipeline.drive; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    makers = ("wayloom.exports.drive_outputs", "wayloom.exports.source", "wayloom.stitching.voxel_map", "wayloom.tiles.pyramid")
    writers = ("wayloom.pipeline.drive_products", "laspy", "scipy.spatial", "scipy.special", "matplotlib")
    assert "wayloom.pipeline.drive" in told
    assert not {*makers, *writers} & set(told)
