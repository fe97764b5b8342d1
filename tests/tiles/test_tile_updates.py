"""An updated pyramid is the pyramid of the changed map, byte for byte, and an update costs what it touches."""

import numpy as np
import pytest
from made_maps import made_map, made_tracks

from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.stitching.layer_names import LAYERS
from wayloom.tiles.formats import SERVED_LAYERS, TILE_FORMATS, Tile, tile_layer
from wayloom.tiles.grid import TileAddress, pixel_from_lonlat
from wayloom.tiles.levels import Level, add_levels, coarser, decode_level, encode_level, finest_level
from wayloom.tiles.pyramid import WholeMap
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.updates import block_zoom, margin_px, touched_tiles, updated_tiles

Tiles = dict[tuple[str, TileAddress], bytes]


class ChangedMap:
    """The map after a change, over the counts that were kept before it."""

    def __init__(self, after: WholeMap, before: Tiles, of: str = "static") -> None:
        self.after, self.before, self.of = after, before, of
        self.voxels, self.tracks = after.voxels, after.tracks
        self.read = 0

    def stored(self, name: str, address: TileAddress) -> bytes | None:
        self.read += name == "counts"
        return self.before.get((tile_layer(name, self.of), address))


def by_address(tiles) -> Tiles:
    found: Tiles = {}
    for tile in tiles:
        assert isinstance(tile, Tile)
        key = (tile.layer, TileAddress(tile.z, tile.x, tile.y))
        assert key not in found
        found[key] = tile.data
    return found


def whole(city, tracks, settings: TileSettings, of: str = "static") -> tuple[WholeMap, Tiles]:
    source = WholeMap(city, city.frame, settings, tracks)
    return source, by_address(updated_tiles(source.blocks, source, settings, of))


def changed_blocks(city, rows, settings: TileSettings) -> set[TileAddress]:
    """The blocks of these voxels and of their margins."""
    pixels = pixel_from_lonlat(wgs84.lonlatheight_from_enu(city.points_enu[rows], city.frame)[:, :2], settings.max_zoom)
    margin, shift = margin_px(settings), 8 + settings.max_zoom - block_zoom(settings)
    return {
        TileAddress(block_zoom(settings), int(x + dx) >> shift, int(y + dy) >> shift)
        for x, y in pixels
        for dx in (-margin, 0, margin)
        for dy in (-margin, 0, margin)
    }


def updated(before: Tiles, after: WholeMap, changed: set[TileAddress], settings: TileSettings, of: str = "static") -> Tiles:
    touched = touched_tiles(changed, settings, of)
    new = by_address(updated_tiles(changed, ChangedMap(after, before, of), settings, of))
    assert all(address in touched[layer, address.z] for layer, address in new), "a tile beyond its scope"
    kept = {key: data for key, data in before.items() if key[1] not in touched.get((key[0], key[1].z), ())}
    return kept | new


SETTINGS = [
    TileSettings(),
    TileSettings(min_zoom=3, max_zoom=19, points_zoom=16, features_max_zoom=19, fine_cells_from_zoom=0, dot_from_zoom=17),
    TileSettings(min_zoom=14, max_zoom=17, points_zoom=18, features_max_zoom=17, fine_cells_from_zoom=20),
]


@pytest.mark.parametrize("settings", SETTINGS, ids=["default", "other zooms", "points finer than pictures"])
@pytest.mark.parametrize(("seed", "of"), [(0, "static"), (1, "static"), (2, "parked")])
def test_an_updated_pyramid_is_that_of_the_changed_map(seed: int, of: str, settings: TileSettings) -> None:
    rng, city = np.random.default_rng(seed), made_map(1500, seed=seed)
    middle = city.points_enu[rng.integers(len(city))]
    near = np.linalg.norm(city.points_enu - middle, axis=1) < 40.0
    gone, same = city.take(near), city.take(~near)
    for before, after, rows in ((city, same, near), (same, city, near)):
        _, tiles = whole(before, made_tracks(city), settings, of)
        source, expected = whole(after, made_tracks(city), settings, of)
        assert updated(tiles, source, changed_blocks(city, np.flatnonzero(rows), settings), settings, of) == expected
    assert len(gone) > 3


def test_an_overlay_has_the_pictures_and_points_of_its_voxels_under_its_own_name_and_no_tracks() -> None:
    city = made_map(500)
    _, static = whole(city, made_tracks(city), TileSettings())
    _, parked = whole(city, made_tracks(city), TileSettings(), "parked")
    names = {"parked": "semantic"} | {f"parked-{name}": name for name in ("points", "cloud", "tilesets", "counts")}
    assert {layer for layer, _ in parked} == set(names)
    assert min(address.z for layer, address in parked if layer == "parked") == TileSettings().overlays_from_zoom
    for (layer, address), data in parked.items():
        own = data.replace(b"/parked-cloud/", b"/cloud/").replace(b"/parked-tilesets/", b"/tilesets/")
        assert static[names[layer], address] == (own if layer == "parked-tilesets" else data)
    assert any(b"/parked-cloud/" in data for data in parked.values())


def test_a_track_that_comes_and_goes_is_on_the_tiles_of_its_blocks_and_of_those_beside_them() -> None:
    settings, city = TileSettings(), made_map(300)
    one, both = made_tracks(city)[:1], made_tracks(city)
    moved = WholeMap(city.take(np.zeros(0, np.int64)), city.frame, settings, both[1:])
    for before, after in ((one, both), (both, one)):
        _, tiles = whole(city, before, settings)
        source, expected = whole(city, after, settings)
        assert updated(tiles, source, set(moved.blocks), settings) == expected


def test_a_map_that_becomes_empty_has_no_tiles() -> None:
    settings, city = TileSettings(), made_map(200)
    source, tiles = whole(city, [], settings)
    empty = WholeMap(city.take(np.zeros(0, np.int64)), city.frame, settings, [])
    assert tiles
    assert updated(tiles, empty, set(source.blocks), settings) == {}


def test_an_update_reads_three_neighbours_of_each_tile_on_its_way_to_the_top_and_no_more() -> None:
    settings, city = TileSettings(), made_map(3000)
    source, tiles = whole(city, [], settings)
    block = sorted(source.blocks)[len(source.blocks) // 2]
    update = ChangedMap(source, tiles)
    made = list(updated_tiles({block}, update, settings))
    steps = block.z - 10
    assert update.read <= 3 * steps + 9 * steps  # siblings, and the neighbours whose margins a line could reach
    assert len(made) < len(tiles) / 2


def test_counts_come_back_from_their_bytes_and_damaged_ones_are_refused() -> None:
    level = finest_level(np.random.default_rng(0).uniform(-0.01, 0.01, (500, 2)), np.full(500, 2, np.uint8), 20)
    back = decode_level(encode_level(level))
    assert back.zoom == 20
    assert (back.cell == level.cell).all()
    assert (back.count == level.count).all()
    for damaged in (b"", encode_level(level)[:-1], b"x" + encode_level(level)):
        with pytest.raises(InputError, match="is no tile of counts"):
            decode_level(damaged)


def test_the_sum_of_the_parts_is_the_level() -> None:
    level = finest_level(np.random.default_rng(1).uniform(-0.01, 0.01, (500, 2)), np.full(500, 2, np.uint8), 18)
    parts = [part for _, part in level.tiles()]
    total = add_levels(17, map(coarser, parts))
    assert (total.cell == coarser(level).cell).all()
    assert (total.count == coarser(level).count).all()
    assert len(Level.empty(3).cell) == len(add_levels(3, []).cell) == 0


def test_no_layer_is_named_twice_and_what_moves_is_not_served() -> None:
    names = [tile_layer(name, of) for of in LAYERS for name in TILE_FORMATS]
    assert len(set(names)) == len(names)
    assert len(set(SERVED_LAYERS)) == len(SERVED_LAYERS)
    assert {"semantic", "features", "points", "parked", "parked-points", "unconfirmed", "unconfirmed-points"} <= {*SERVED_LAYERS}
    assert not any("moving" in name or "counts" in name for name in SERVED_LAYERS)
