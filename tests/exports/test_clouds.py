"""Clouds that are exported, read back by laspy and copclib."""

import json

import copclib
import laspy
import numpy as np
import pyproj
import pytest

from exports.made_sources import MadeSource, made_source
from tiles.made_maps import made_map
from wayloom.config.classes import CLASS_ID, PALETTE, VOID
from wayloom.exports import copc
from wayloom.exports.copc import write_copc
from wayloom.exports.las import ASPRS_OF_CLASS, PROVENANCE_RECORD, projection_at
from wayloom.exports.laz import write_laz
from wayloom.exports.ply import write_ply
from wayloom.exports.points import PointBatch, map_batches, together
from wayloom.files.gps_time import adjusted_gps_s
from wayloom.files.ply import read_ply, read_vertices
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame

MM = 0.001
WRITERS = pytest.mark.parametrize("write", [write_laz, write_copc])


@pytest.fixture(scope="module")
def city() -> MadeSource:
    return made_source(3000)


def batch(points, label, frame=None):
    n = len(points)
    zeros = np.zeros(n, np.int64)
    return PointBatch(
        np.array(points, float), np.array(label, np.uint8), np.zeros(n, np.uint8), np.zeros(n, np.float32), np.zeros(n, np.uint8),
        np.ones(n, np.uint16), zeros, zeros,
    )  # fmt: skip


def written(source, folder, write):
    file = folder / "cloud.laz"
    count = write(file, map_batches(source, None), projection_at(source.place, source.frame), source.provenance())
    cloud = laspy.read(file)
    assert count == len(cloud) == len(source.whole)
    return cloud


def row_order(source, cloud):
    """For each voxel its row in the cloud, by place."""
    lon_lat_height = wgs84.lonlatheight_from_enu(source.whole.points_enu, source.frame)
    utm = wgs84.utm_from_lonlatheight(lon_lat_height, 32632)
    there, here = np.rint(np.array(cloud.xyz) / MM).astype(int), np.rint(utm / MM).astype(int)
    return utm, np.lexsort(there.T)[np.argsort(np.lexsort(here.T), kind="stable")]


@WRITERS
def test_points_lie_in_utm_at_their_true_place_with_all_that_the_map_knows_of_them(city, tmp_path, write):
    cloud, whole = written(city, tmp_path, write), city.whole
    assert cloud.header.parse_crs() == pyproj.CRS.from_epsg(32632)
    assert cloud.header.system_identifier == "ellipsoidal heights"
    utm, rows = row_order(city, cloud)
    assert np.abs(np.array(cloud.xyz)[rows] - utm).max() < 0.5 * MM + 1e-6
    assert np.array_equal(np.array(cloud.label)[rows], whole.label)
    assert np.array_equal(np.array(cloud.intensity)[rows], whole.grey.astype(int) * 257)
    assert np.allclose(np.array(cloud.sigma)[rows], whole.sigma_m, atol=0.5 * MM)
    assert np.array_equal(np.array(cloud.drives)[rows], whole.drives)
    assert np.allclose(np.array(cloud.confidence)[rows] / 255.0, whole.confidence, atol=0.5 / 255 + 1e-6)
    assert np.array_equal(np.array(cloud.gps_time)[rows], adjusted_gps_s(whole.last_seen_ns))
    colours = np.column_stack([cloud.red, cloud.green, cloud.blue])[rows]
    assert np.array_equal(colours // 257, PALETTE[whole.label])
    for name, asprs in ASPRS_OF_CLASS.items():
        assert (np.array(cloud.classification)[rows][whole.label == CLASS_ID[name]] == asprs).all()


@WRITERS
def test_the_header_says_what_clock_which_version_and_where_it_came_from(city, tmp_path, write):
    header = written(city, tmp_path, write).header
    assert header.version == "1.4"
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    record = next(one for one in header.vlrs if (one.user_id, one.record_id) == ("wayloom", PROVENANCE_RECORD))
    assert json.loads(record.record_data_bytes()) == city.provenance()
    assert header.number_of_points_by_return[0] == header.point_count


@WRITERS
def test_a_drive_without_a_place_is_in_its_own_frame(tmp_path, write):
    points = [[1.5, -2.25, 10.125], [0.0, 0.0, 0.0]]
    write(tmp_path / "own.laz", [batch(points, [0, VOID])], projection_at(np.zeros(3), None), {})
    cloud = laspy.read(tmp_path / "own.laz")
    assert cloud.header.parse_crs() is None
    assert np.allclose(sorted(np.array(cloud.xyz).tolist()), sorted(points), atol=MM)
    assert sorted(np.array(cloud.classification).tolist()) == [1, 11]


@WRITERS
def test_an_empty_cloud_is_a_cloud(tmp_path, write):
    write(tmp_path / "none.laz", [], projection_at(np.zeros(3), None), {})
    assert len(laspy.read(tmp_path / "none.laz")) == 0


@WRITERS
def test_equal_points_in_other_batches_give_equal_files(city, tmp_path, write):
    projection = projection_at(city.place, city.frame)
    for name, size in (("a", 1), ("b", 1000)):
        write(tmp_path / name, together(map_batches(city, None), size), projection, {})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.fixture(scope="module")
def octree(tmp_path_factory):
    """A COPC of several levels: few points to a node, few cells to its grid."""
    source = MadeSource(made_map(20_000))
    file = tmp_path_factory.mktemp("copc") / "city.copc.laz"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(copc, "NODE_POINTS", 500)
        patch.setattr(copc, "GRID", 8)
        write_copc(file, map_batches(source, None), projection_at(source.place, source.frame), {})
    return source, file


def test_copclib_finds_every_point_within_the_bounds_of_its_node(octree):
    source, file = octree
    reader = copclib.FileReader(str(file))
    nodes = reader.GetAllNodes()
    assert len({node.key.d for node in nodes}) >= 3
    assert sum(node.point_count for node in nodes) == len(source.whole)
    assert reader.ValidateSpatialBounds()


def test_laspy_queries_a_copc_by_box_and_by_level(octree):
    source, file = octree
    everything = laspy.read(file)
    with laspy.CopcReader.open(str(file)) as reader:
        assert len(reader.query()) == len(source.whole)
        low, high = np.percentile(np.array(everything.xyz), [30, 60], axis=0)
        found = reader.query(laspy.copc.Bounds(low, high))
        inside = ((np.array(everything.xyz) >= low) & (np.array(everything.xyz) <= high)).all(axis=1)
        assert len(found) == inside.sum() > 100
        counts = [len(reader.query(level=range(depth + 1))) for depth in range(4)]
    assert 0 < counts[0] < counts[1] < counts[2]
    info = reader.copc_info
    times = adjusted_gps_s(source.whole.last_seen_ns)
    assert (info.gps_min, info.gps_max) == (times.min(), times.max())


def test_a_coarse_level_of_a_copc_covers_the_whole_map(octree):
    _, file = octree
    with laspy.CopcReader.open(str(file)) as reader:
        points = reader.query(level=0)
        coarse = np.column_stack([points.x, points.y, points.z])
        info = reader.copc_info
    everything = np.array(laspy.read(file).xyz)
    cells = [
        np.unique(np.floor((one - info.center + info.halfsize) / info.spacing).clip(0, 7), axis=0) for one in (coarse, everything)
    ]
    assert np.array_equal(*cells)
    assert len(coarse) == len(cells[0])


def test_a_ply_lies_near_its_origin_with_up_up_at_its_place(city, tmp_path):
    write_ply(tmp_path / "cloud.ply", map_batches(city, None), city.place, city.frame)
    cloud, rows = read_ply(tmp_path / "cloud.ply"), read_vertices(tmp_path / "cloud.ply")
    comment = (tmp_path / "cloud.ply").read_bytes()[:300].split(b"ENU at ")[1].split(b" (")[0]
    origin = MapFrame(*map(float, comment.split()))
    assert np.linalg.norm(cloud.points, axis=1).max() < 300.0  # the map is 300 m wide
    truth = wgs84.lonlatheight_from_enu(np.concatenate([city.voxels(key).points_enu for key in city.keys]), city.frame)
    back = wgs84.lonlatheight_from_enu(cloud.points, origin)
    assert np.abs(back - truth).max() < 1e-8
    assert np.abs(cloud.points[:, 2] + origin.height_m - truth[:, 2]).max() < 0.01  # over 200 m the Earth falls by 4 mm
    whole = np.concatenate([city.voxels(key).label for key in city.keys])
    assert np.array_equal(cloud.labels, whole)
    assert np.array_equal(cloud.colours, PALETTE[whole])
    assert rows["sigma"].max() == np.float32(0.05)
    assert rows["time"].min() > 1e9
