"""3D Tiles: read back by the standards' rules, voxels lie where the map has them, and every level counts what the map counts."""

import dataclasses
import itertools
import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from cloud_files import SMALL, TURN, attribute, gltf_of, tiles_of, walk, write_folder
from made_maps import made_map

from service_kit.javascript import gltf_errors
from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES, PALETTE
from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.tiles.cloud_pyramid import file_zoom, top_zoom
from wayloom.tiles.gltf_points import MOST_BYTES, MOST_POINTS, CloudPoints, cloud_of, decode_glb, encode_glb, joined_cloud
from wayloom.tiles.grid import TileAddress
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.tileset import decode_tileset, encode_tileset, node_of

FOLDERS = ("cloud", "tilesets")


@pytest.fixture(scope="module")
def city():
    return made_map(20_000)


@pytest.fixture(scope="module")
def root(tmp_path_factory, city) -> Path:
    return write_folder(tmp_path_factory.mktemp("cloud"), city)


def made_points(count: int, seed: int = 0) -> CloudPoints:
    rng = np.random.default_rng(seed)
    place = np.unique(rng.integers(-5_000, 5_000, (count, 3)), axis=0) + np.array([50_000_000, -3, 40])
    n = len(place)
    columns = (rng.integers(0, 19, n), rng.integers(0, 256, n), rng.integers(1, 256, n))
    days = rng.integers(10_000, 30_000, n).astype(np.uint16)
    return CloudPoints(place, np.ones(n, np.int64), *(column.astype(np.uint8) for column in columns), days)


def same(one: CloudPoints, other: CloudPoints) -> bool:
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(CloudPoints))


def test_the_finest_tiles_hold_every_voxel_at_its_place_on_earth_in_the_colour_of_its_class(city, root):
    found = []
    for tile, T, file, _ in walk(root):
        if tile["geometricError"] == 0.0:
            data = file.read_bytes()
            position, label = attribute(data, "POSITION").astype(float), attribute(data, "_FEATURE_ID_0")[:, 0]
            ecef = (np.column_stack([position, np.ones(len(position))]) @ (T @ TURN).T)[:, :3]
            linear = attribute(data, "COLOR_0")[:, :3] / 255.0
            shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
            # half a step of the linear byte, by the slope of the transfer function at black, where it is steepest
            assert np.abs(shown * 255.0 - PALETTE[label]).max() <= 12.92 / 2 + 1e-9
            found.append(np.column_stack([wgs84.enu_from_lonlatheight(wgs84.lonlatheight_from_ecef(ecef), city.frame), label]))
    back = np.concatenate(found)
    assert len(back) == len(city)
    keys = np.round(city.points_enu * 256.0).astype(int)
    order, other = np.lexsort(keys.T), np.lexsort(np.round(back[:, :3] * 256.0).astype(int).T)
    assert np.abs(back[other, :3] - city.points_enu[order]).max() <= 0.5 / 256.0 + 1e-6
    assert back[other, 3].astype(int).tolist() == city.label[order].tolist()


def test_every_level_counts_each_class_as_the_map_does(city, root):
    """A level of a tree that is refined by replacing: the tiles of one zoom, and those above it that have none below."""
    tiles = [(tile, int(file.parts[-3]), decode_glb(file.read_bytes())) for tile, _, file, _ in walk(root)]
    deepest = max(zoom for _, zoom, _ in tiles)
    assert deepest == 20
    for zoom in range(top_zoom(SMALL), deepest + 1):
        cut = [points for tile, z, points in tiles if z == zoom or (z < zoom and tile["geometricError"] == 0.0)]
        assert sum(points.class_counts() for points in cut).tolist() == city.class_counts().tolist(), zoom


def test_a_tile_tells_its_counts_by_class_in_its_table_of_classes(root):
    for _, _, file, _ in walk(root):
        data = file.read_bytes()
        document, body = gltf_of(data)
        views, table = document["bufferViews"], document["extensions"]["EXT_structural_metadata"]["propertyTables"][0]
        raw = [body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] for view in views]
        properties = table["properties"]
        offsets = np.frombuffer(raw[properties["name"]["stringOffsets"]], "<u4")
        text = raw[properties["name"]["values"]]
        assert [text[a:b].decode() for a, b in itertools.pairwise(offsets)] == list(CLASS_NAMES)
        label, voxels = attribute(data, "_FEATURE_ID_0")[:, 0], attribute(data, "_VOXELS")[:, 0]
        expected = np.bincount(label, voxels, CLASS_COUNT)
        assert np.frombuffer(raw[properties["voxels"]["values"]], "<u4").tolist() == expected.tolist()
        assert all(view["byteOffset"] % 8 == 0 for view in views)


def test_boxes_hold_what_is_in_them_and_errors_shrink_on_the_way_down(root):
    for tile, _, file, above in walk(root):
        box = np.array(tile["boundingVolume"]["box"])
        local = attribute(file.read_bytes(), "POSITION") @ TURN[:3, :3].T
        assert (np.abs(local - box[:3]) <= box[[3, 7, 11]] + 1e-9).all()
        if above is not None:
            assert tile["geometricError"] <= above["geometricError"]


def test_tiles_keep_their_limits(root):
    for _, _, file, _ in walk(root):
        assert len(decode_glb(file.read_bytes())) <= SMALL.cloud_points_per_tile
    assert TileSettings().cloud_points_per_tile == MOST_POINTS
    full = made_points(40_000)
    columns = (full.place, full.voxels, full.label, full.confidence, full.drives, full.last_seen)
    assert 0.98 * MOST_BYTES < len(encode_glb(CloudPoints(*(column[:MOST_POINTS] for column in columns)))) <= MOST_BYTES


def test_what_is_written_is_read_back_far_from_the_frames_origin_too():
    points = made_points(3000)
    assert same(decode_glb(encode_glb(points)), points)


def test_joined_cells_are_what_a_naive_twin_adds_up():
    points, edge = made_points(2000), 4096
    joined = joined_cloud([points], edge)
    expected = Counter()
    for place, label in zip(points.place.tolist(), points.label.tolist(), strict=True):
        expected[(*(value // edge for value in place), label)] += 1
    found = Counter()
    for place, label, voxels in zip(joined.place.tolist(), joined.label.tolist(), joined.voxels.tolist(), strict=True):
        found[(*(value // edge for value in place), label)] += voxels
    assert found == expected
    assert joined.edge == edge


def test_a_point_tells_the_day_on_which_a_drive_saw_it_last_and_of_joined_ones_the_latest(city):
    day = city.last_seen_ns // (86_400 * 10**9)
    points = decode_glb(encode_glb(cloud_of(city)))
    assert sorted(points.last_seen.tolist()) == sorted(day.tolist())
    joined = joined_cloud([points], 256 * 10_000)
    for label in np.unique(points.label):
        assert joined.last_seen[joined.label == label].max() == points.last_seen[points.label == label].max()


def test_joining_in_steps_over_more_than_the_limit_doubles_cells_and_keeps_counts():
    points = made_points(5000)
    thin = joined_cloud([points], 1, limit=300)
    assert len(thin) <= 300
    assert thin.edge > 256
    assert thin.class_counts().tolist() == points.class_counts().tolist()


@pytest.mark.parametrize("damage", [lambda d: d[:40], lambda d: d[:-1], lambda d: b"", lambda d: b"WLPO" + d[4:]])
def test_damaged_contents_and_tilesets_are_refused(damage):
    with pytest.raises(InputError, match="is no 3D tile"):
        decode_glb(damage(encode_glb(made_points(10))))
    with pytest.raises(InputError, match="is no tileset"):
        decode_tileset(damage(encode_tileset(node_of(TileAddress(18, 1, 2), made_points(10)), FOLDERS)))


def test_a_tileset_is_read_back_as_it_was_written():
    below = [node_of(TileAddress(19, 2 * 70 + k, 90), made_points(5 - 2 * k, k)) for k in (0, 1, 2)]
    tree = node_of(TileAddress(18, 70, 45), joined_cloud([made_points(50)], 64), below)
    assert decode_tileset(encode_tileset(tree, FOLDERS)) == tree


def test_files_are_small_and_cover_three_zooms_each(root):
    for file in root.parent.glob("tilesets/*/*/*.json"):
        zooms = {node.address.z for node in decode_tileset(file.read_bytes()).walk()}
        assert min(zooms) == int(file.parts[-3])
        assert max(zooms) - min(zooms) <= 3
    assert [file_zoom(zoom, TileSettings()) for zoom in range(12, 21)] == [12, 12, 12, 15, 15, 15, 18, 18, 18]


def test_the_root_turns_the_frame_to_the_earth_exactly_where_the_frame_is(city, root):
    transform = np.array(json.loads(root.read_text())["root"]["transform"]).reshape(4, 4).T
    lon, lat, height = wgs84.lonlatheight_from_ecef(transform[None, :3, 3])[0].tolist()
    assert (lon, lat) == pytest.approx((city.frame.lon_deg, city.frame.lat_deg), abs=1e-12)
    assert height == pytest.approx(city.frame.height_m, abs=1e-7)
    assert math.isclose(np.linalg.det(transform[:3, :3]), 1.0, abs_tol=1e-14)


def test_equal_maps_give_equal_bytes(city):
    assert tiles_of(city) == tiles_of(made_map(20_000))


def test_the_order_of_voxels_does_not_matter(city):
    points = cloud_of(city)
    shuffled = cloud_of(city.take(np.random.default_rng(1).permutation(len(city))))
    assert same(points, shuffled)


def test_the_khronos_validator_finds_no_error_in_any_content_and_one_in_a_damaged_file(root, tmp_path):
    files = sorted(root.parent.glob("cloud/*/*/*.glb"))
    assert len(files) > 50
    assert gltf_errors(files) == []
    damaged = tmp_path / "damaged.glb"
    damaged.write_bytes(files[0].read_bytes().replace(b'"VEC3"', b'"VEC2"'))
    assert gltf_errors([damaged])
