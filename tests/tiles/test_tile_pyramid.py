import dataclasses
import math
from collections import Counter

import cv2
import mapbox_vector_tile
import numpy as np
import pytest
from made_maps import made_map, made_tracks

from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES, PALETTE
from wayloom.errors import InputError, StageError
from wayloom.geodesy import wgs84
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.grid import TILE_PX, TileAddress, pixel_from_lonlat, tile_bounds
from wayloom.tiles.levels import OCCUPIED, coarser, dilated, finest_level
from wayloom.tiles.mvt import BUFFER, EXTENT, LonLatTrack, clip, count_property, tiles_of_track
from wayloom.tiles.png import draw
from wayloom.tiles.points import PointTile, decode_points, encode_points, origin_of, voxel_downsampled
from wayloom.tiles.pyramid import build_tiles, tracks_of
from wayloom.tiles.settings import TileSettings


@pytest.fixture(scope="module")
def city():
    return made_map()


@pytest.fixture(scope="module")
def tiles(city):
    return list(build_tiles(city, city.frame, tracks=made_tracks(city)))


def decoded(tile):
    return mapbox_vector_tile.decode(tile.data, default_options={"y_coord_down": True})


def lon_lat(city):
    return wgs84.lonlatheight_from_enu(city.points_enu, city.frame)[:, :2]


def naive_counts(city, zoom):
    """Class counts of every pixel, from all voxels, by hand."""
    out = Counter()
    for (lon, lat), label in zip(lon_lat(city).tolist(), city.label.tolist(), strict=True):
        x = (lon + 180.0) / 360.0 * 2**zoom * 256
        y = (1.0 - math.asinh(math.tan(math.radians(lat))) / math.pi) / 2.0 * 2**zoom * 256
        out[int(y), int(x), label] += 1
    return out


def test_a_level_counts_what_its_naive_twin_counts_at_every_zoom(city):
    level = finest_level(lon_lat(city), city.label, 20)
    for zoom in range(20, 11, -1):
        classes = level.code < CLASS_COUNT
        rows = zip(level.row[classes], level.column[classes], level.code[classes], level.count[classes], strict=True)
        assert {(int(r), int(c), int(k)): int(n) for r, c, k, n in rows} == naive_counts(city, zoom)
        level = coarser(level)


def test_occupied_pixels_of_the_finest_level_are_counted_at_every_zoom(city):
    level = finest_level(lon_lat(city), city.label, 20)
    pixels = len(np.unique(pixel_from_lonlat(lon_lat(city), 20), axis=0))
    for _ in range(8):
        assert level.count[level.code == OCCUPIED].sum() == pixels
        level = coarser(level)


def test_class_counts_are_conserved_at_every_zoom_and_in_every_format(city, tiles):
    expected = {CLASS_NAMES[c]: int(n) for c, n in enumerate(city.class_counts()) if n}
    by_zoom = {}
    for tile in tiles:
        if tile.layer == TILE_FORMATS["mvt"].layer:
            for feature in decoded(tile).get("semantic", {"features": []})["features"]:
                p = feature["properties"]
                found = {name: p[count_property(c)] for c, name in enumerate(CLASS_NAMES) if count_property(c) in p}
                assert sum(found.values()) == p["count"]
                by_zoom.setdefault(tile.z, Counter()).update(found)
        elif tile.layer == TILE_FORMATS["points"].layer:
            points = decode_points(tile.data)
            for label, n in zip(points.label.tolist(), points.voxels.tolist(), strict=True):
                by_zoom.setdefault("points", Counter())[CLASS_NAMES[label]] += n
    assert set(by_zoom) == {"points", *range(12, 19)}
    for zoom, found in by_zoom.items():
        assert found == expected, zoom


def test_every_zoom_has_tiles_and_every_tile_lies_under_a_tile_of_the_zoom_above(tiles):
    for layer, zooms in (("semantic", range(12, 21)), ("features", range(12, 19)), ("points", range(18, 19))):
        addresses = {TileAddress(t.z, t.x, t.y) for t in tiles if t.layer == layer}
        assert {a.z for a in addresses} == set(zooms)
        assert all(TileAddress(a.z - 1, a.x >> 1, a.y >> 1) in addresses for a in addresses if a.z > zooms[0])


def test_no_tile_is_built_twice_and_media_types_are_those_of_the_formats(tiles):
    assert len({(t.layer, t.z, t.x, t.y) for t in tiles}) == len(tiles)
    assert {(t.layer, t.media_type) for t in tiles} == {(f.layer, f.media_type) for f in TILE_FORMATS.values() if f.served}


def test_equal_maps_give_equal_bytes(city, tiles):
    assert list(build_tiles(made_map(), city.frame, tracks=made_tracks(city))) == tiles


def test_a_voxel_is_drawn_in_its_colour_at_its_place():
    city = made_map(voxels=1)
    label, drawn = int(city.label[0]), set()
    for tile in build_tiles(city, city.frame):
        if tile.layer == "semantic":
            rgba = cv2.cvtColor(cv2.imdecode(np.frombuffer(tile.data, np.uint8), -1), cv2.COLOR_BGRA2RGBA)
            column, row = (pixel_from_lonlat(lon_lat(city), tile.z)[0] - [tile.x * TILE_PX, tile.y * TILE_PX]).tolist()
            if 0 <= row < TILE_PX and 0 <= column < TILE_PX:  # a dot at the edge is also on the neighbour's picture
                assert rgba[row, column, :3].tolist() == PALETTE[label].tolist()
                assert rgba[row, column, 3] >= 80
                drawn.add(tile.z)
            assert 0 < (rgba[..., 3] > 0).sum() <= (9 if tile.z >= 19 else 1)
    assert len(drawn) > 3


def test_pictures_are_clear_where_nothing_is_and_the_majority_rules(city):
    level = finest_level(lon_lat(city), city.label, 20)
    for _ in range(5):
        level = coarser(level)
    address, part = next(level.tiles())
    rgba = draw(part, 20)
    inside = np.zeros((256, 256), bool)
    inside[part.row % 256, part.column % 256] = True
    assert ((rgba[..., 3] > 0) == inside).all()
    assert address.z == 15


def test_dots_are_widened_over_the_edges_of_tiles():
    place = np.array([[0.0, 0.0]])  # the corner of four tiles
    level = dilated(finest_level(place, np.array([2], np.uint8), 20))
    assert len({address for address, _ in level.tiles()}) == 4
    assert (level.code != OCCUPIED).sum() == 9


def test_cells_lie_where_their_voxels_are(city, tiles):
    """The cell of each voxel of one fine vector tile, found by hand, is there with at least that voxel's class."""
    tile = max((t for t in tiles if t.layer == "features" and t.z == 18), key=lambda t: len(t.data))
    cells = {}
    for feature in decoded(tile)["semantic"]["features"]:
        ring = np.array(feature["geometry"]["coordinates"][0])
        assert ring.min() >= 0
        assert ring.max() <= EXTENT
        assert np.ptp(ring, axis=0).tolist() == [32, 32]
        cells[tuple((ring.min(axis=0) // 32).tolist())] = feature["properties"]
    west, south, east, north = tile_bounds(TileAddress(tile.z, tile.x, tile.y))
    places, here = pixel_from_lonlat(lon_lat(city), 17), 0
    for (lon, lat), (column, row), label in zip(lon_lat(city), places, city.label, strict=True):
        if west <= lon < east and south < lat <= north:
            assert count_property(int(label)) in cells[(int(column % 128), int(row % 128))]
            here += 1
    assert here >= len(cells) > 0


def test_tracks_are_on_the_vector_tiles_that_they_cross_with_their_drives_id(tiles):
    drives = {z: set() for z in range(14, 19)}
    for tile in tiles:
        if tile.layer == "features" and tile.z < 14:
            assert "coverage" not in decoded(tile)
        elif tile.layer == "features":
            for feature in decoded(tile).get("coverage", {"features": []})["features"]:
                drives[tile.z].add(feature["properties"]["drive"])
                lines = feature["geometry"]["coordinates"]
                points = np.array(lines if feature["geometry"]["type"] == "LineString" else [p for line in lines for p in line])
                assert points.min() >= -BUFFER
                assert points.max() <= EXTENT + BUFFER
    assert all(found == {"drive-a", "drive-b"} for found in drives.values())


def test_a_track_over_the_antimeridian_is_not_drawn_around_the_world():
    track = LonLatTrack("d", np.array([[179.999, 0.0], [-179.999, 0.0], [-179.99, 0.0]]))
    assert {a.x for a in tiles_of_track(track, 10)} == {0}


def test_clipping_is_what_dense_sampling_says():
    rng = np.random.default_rng(0)
    for _ in range(200):
        a, b = rng.uniform(-2, 2, (2, 2))
        samples = a + np.linspace(0, 1, 20_001)[:, None] * (b - a)
        inside = samples[(np.abs(samples) <= 1).all(axis=1)]
        piece = clip(a, b, -1.0, 1.0)
        if len(inside):
            assert np.allclose(piece[0], inside[0], atol=1e-3)
            assert np.allclose(piece[1], inside[-1], atol=1e-3)
        else:
            assert piece is None or np.linalg.norm(piece[1] - piece[0]) < 1e-3
    assert clip(np.zeros(2), np.zeros(2), -1.0, 1.0) is not None
    assert clip(np.full(2, 3.0), np.array([3.0, -3.0]), -1.0, 1.0) is None


def test_points_come_back_from_their_tile_to_the_centimetre(city, tiles):
    back = []
    for tile in tiles:
        if tile.layer == "points":
            points = decode_points(tile.data)
            assert points.tile == TileAddress(tile.z, tile.x, tile.y)
            llh = wgs84.lonlatheight_from_enu(points.position, points.origin)
            back.append(np.column_stack([wgs84.enu_from_lonlatheight(llh, city.frame), points.label]))
    back = np.concatenate(back)
    assert len(back) == len(city)
    one = back[np.lexsort(back[:, :3].round(1).T)]
    nearest = np.array([np.abs(back[:, :3] - p).max(axis=1).min() for p in city.points_enu[::50]])
    assert nearest.max() <= 0.0051
    assert Counter(one[:, 3].astype(int).tolist()) == Counter(city.label.tolist())


def made_points(count, reach_m=40.0, seed=0):
    rng = np.random.default_rng(seed)
    tile = TileAddress(18, 137181, 90044)
    return PointTile(
        tile,
        origin_of(tile, 110.0),
        rng.uniform(-reach_m, reach_m, (count, 3)),
        np.ones(count, np.uint32),
        rng.integers(0, 9, count).astype(np.uint8),
        rng.integers(0, 256, count).astype(np.uint8),
        rng.integers(1, 4, count).astype(np.uint8),
    )


def test_a_full_tile_is_thinned_to_its_limit_and_every_class_keeps_its_count():
    points = made_points(20_000, reach_m=3.0)
    thin = voxel_downsampled(points, 500, 0.1)
    assert 19 <= len(thin) <= 500
    for label in range(9):
        assert thin.voxels[thin.label == label].sum() == (points.label == label).sum()
    assert np.abs(thin.position).max() <= 3.0


def test_a_tile_within_its_limit_is_left_alone():
    points = made_points(100)
    assert voxel_downsampled(points, 100, 0.1) is points


def test_points_that_reach_beyond_16_bits_of_centimetres_get_a_coarser_scale():
    points = made_points(100, reach_m=1000.0)
    assert np.abs(decode_points(encode_points(points)).position - points.position).max() <= 0.0201


@pytest.mark.parametrize("damage", [lambda d: d[:40], lambda d: d[:-1], lambda d: b"", lambda d: b"GLTF" + d])
def test_damaged_point_tiles_are_refused(damage):
    with pytest.raises(InputError, match="is no point tile"):
        decode_points(damage(encode_points(made_points(10))))


def test_a_map_in_a_drives_own_frame_has_no_tiles(city):
    with pytest.raises(StageError, match="geo-reference the drives first"):
        next(build_tiles(dataclasses.replace(city, frame=None), None))


def test_a_map_at_the_pole_is_refused():
    city = made_map(10, lat=89.0)
    with pytest.raises(InputError, match="lies on no tile"):
        list(build_tiles(city, city.frame))


def test_an_empty_map_has_no_tiles(city):
    assert list(build_tiles(city.take(np.zeros(0, np.int64)), city.frame)) == []


def test_zooms_out_of_order_are_refused():
    with pytest.raises(ValueError, match="must hold"):
        TileSettings(min_zoom=19)


def test_submaps_of_one_drive_that_touch_are_one_track():
    from submaps.made_submaps import NamedLog, made_geo, made_labels, made_odometry
    from wayloom.submaps.split import make_submaps

    odometry = made_odometry(200, 3)
    placed = list(make_submaps(NamedLog(), odometry, made_labels(len(odometry.points)), made_geo(odometry)))
    tracks = tracks_of(reversed(placed))
    assert len(placed) == 3
    assert len(tracks) == 1
    assert len(tracks[0].points_enu) == len(odometry.keyframes)
