import json

import laspy
import numpy as np
import pyproj
import pytest
from made_maps import made_map

from wayloom.config.classes import CLASS_ID, PALETTE, VOID
from wayloom.files.ply import read_ply
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.tiles.exports import ASPRS_OF_CLASS, export_geojson_track, export_laz, export_ply
from wayloom.tiles.preview import PAPER, TRACK, bar_length_m, top_down


@pytest.fixture(scope="module")
def city():
    return made_map(500)


def test_a_laz_lies_in_utm_at_its_true_place(city, tmp_path):
    export_laz(tmp_path / "cloud.laz", city.points_enu, city.label, city.frame)
    cloud = laspy.read(tmp_path / "cloud.laz")
    crs = cloud.header.parse_crs()
    assert crs == pyproj.CRS.from_epsg(32632)
    lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(np.array(cloud.x), np.array(cloud.y))
    expected = wgs84.lonlatheight_from_enu(city.points_enu, city.frame)
    assert np.abs(lon - expected[:, 0]).max() * 73_000 < 0.002
    assert np.abs(lat - expected[:, 1]).max() * 111_000 < 0.002
    assert np.abs(np.array(cloud.z) - expected[:, 2]).max() < 0.001


def test_a_laz_bears_asprs_classes_our_labels_and_colours(city, tmp_path):
    export_laz(tmp_path / "cloud.laz", city.points_enu, city.label, city.frame)
    cloud = laspy.read(tmp_path / "cloud.laz")
    assert cloud.header.version == "1.4"
    assert np.array_equal(cloud.label, city.label)
    for name, asprs in ASPRS_OF_CLASS.items():
        members = city.label == CLASS_ID[name]
        assert (np.array(cloud.classification)[members] == asprs).all()
    assert np.array_equal(np.column_stack([cloud.red, cloud.green, cloud.blue]) // 257, PALETTE[city.label])


def test_a_laz_without_gnss_is_in_the_drives_own_frame(tmp_path):
    points = np.array([[1.5, -2.25, 10.125], [0.0, 0.0, 0.0]])
    export_laz(tmp_path / "cloud.laz", points, np.array([0, VOID], np.uint8))
    cloud = laspy.read(tmp_path / "cloud.laz")
    assert cloud.header.parse_crs() is None
    assert np.allclose(cloud.xyz, points, atol=0.001)
    assert np.array(cloud.classification).tolist() == [11, 1]


def test_an_empty_laz_is_a_laz(tmp_path):
    export_laz(tmp_path / "cloud.laz", np.zeros((0, 3)), np.zeros(0, np.uint8))
    assert len(laspy.read(tmp_path / "cloud.laz")) == 0


def test_equal_clouds_give_equal_files(city, tmp_path):
    for name in ("a", "b"):
        export_laz(tmp_path / f"{name}.laz", city.points_enu, city.label, city.frame)
        export_ply(tmp_path / f"{name}.ply", city.points_enu, city.label, city.frame)
    for suffix in ("laz", "ply"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_a_ply_comes_back_with_labels_and_colours(city, tmp_path):
    export_ply(tmp_path / "cloud.ply", city.points_enu, city.label, city.frame)
    cloud = read_ply(tmp_path / "cloud.ply")
    assert np.array_equal(cloud.points, city.points_enu)
    assert np.array_equal(cloud.labels, city.label)
    assert np.array_equal(cloud.colours, PALETTE[city.label])


def test_a_track_is_a_wgs84_line_with_longitude_first(city, tmp_path):
    T = se3.from_rotation_translation(np.tile(np.eye(3), (5, 1, 1)), city.points_enu[:5])
    export_geojson_track(tmp_path / "track.geojson", T, city.frame, "drive")
    feature = json.loads((tmp_path / "track.geojson").read_text())["features"][0]
    assert feature["geometry"]["type"] == "LineString"
    assert (
        np.abs(np.array(feature["geometry"]["coordinates"]) - wgs84.lonlatheight_from_enu(city.points_enu[:5], city.frame)).max()
        < 1e-3
    )
    assert 8.3 < feature["geometry"]["coordinates"][0][0] < 8.5


def test_a_preview_shows_points_in_their_colours_and_north_is_up():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 0.0, 0.0]])
    labels = np.array([CLASS_ID["car"], CLASS_ID["road"], CLASS_ID["vegetation"]], np.uint8)
    picture = top_down(points, labels, 0.1)
    at = {
        name: np.argwhere((picture == PALETTE[CLASS_ID[name]]).all(axis=2)).mean(axis=0) for name in ("car", "road", "vegetation")
    }
    assert at["road"][0] == pytest.approx(at["car"][0] - 200, abs=1)
    assert at["vegetation"][1] == pytest.approx(at["car"][1] + 200, abs=1)


def test_in_a_preview_the_higher_point_covers_the_lower():
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 0.0], [3.0, 3.0, 0.0]])
    picture = top_down(points, np.array([8, 0, 2], np.uint8), 0.1)
    assert (picture == PALETTE[8]).all(axis=2).any()
    assert not (picture == PALETTE[0]).all(axis=2).any()


def test_a_preview_never_outgrows_its_limit_and_draws_tracks():
    track = np.column_stack([np.linspace(0, 5000, 50), np.zeros(50), np.zeros(50)])
    picture = top_down(np.zeros((0, 3)), np.zeros(0, np.uint8), 0.1, tracks_enu=(track,), max_size_px=800)
    assert max(picture.shape) <= 802
    assert (picture == TRACK).all(axis=2).sum() > 500


def test_a_preview_of_nothing_is_paper_with_a_scale():
    picture = top_down(np.zeros((0, 3)), np.zeros(0, np.uint8))
    assert (picture == PAPER).all(axis=2).mean() > 0.5


def test_scale_bars_are_round_lengths():
    assert [bar_length_m(x) for x in (1.0, 1.9, 3.0, 7.0, 49.0, 1200.0)] == [1.0, 1.0, 2.0, 5.0, 20.0, 1000.0]
