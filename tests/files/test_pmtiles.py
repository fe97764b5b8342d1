"""PMTiles, read back by the format's own reader."""

import gzip

import pytest
from pmtiles.reader import MemorySource, Reader, all_tiles
from pmtiles.tile import TileType, zxy_to_tileid

from wayloom.files.pmtiles import HEADER, tile_id, write_pmtiles

MVT = "application/vnd.mapbox-vector-tile"
BOUNDS = (8.0, 48.0, 9.0, 49.0)


def archive(folder, tiles, media_type=MVT):
    file = folder / "a.pmtiles"
    count = write_pmtiles(file, tiles, media_type, BOUNDS, lambda low, high: {"zooms": [low, high]})
    return count, MemorySource(file.read_bytes())


def grid(zoom, side, data):
    return [((zoom, x, y), data(x, y)) for x in range(side) for y in range(side)]


@pytest.mark.parametrize("zoom", range(7))
def test_ids_are_those_of_the_reader(zoom):
    for x in range(1 << zoom):
        for y in range(1 << zoom):
            assert tile_id(zoom, x, y) == zxy_to_tileid(zoom, x, y)


def test_ids_of_fine_tiles_are_those_of_the_reader():
    for address in ((20, 549_161, 360_000), (21, 2**21 - 1, 0), (18, 0, 2**18 - 1)):
        assert tile_id(*address) == zxy_to_tileid(*address)


def test_every_tile_comes_back_whatever_order_it_came_in_and_parts_are_joined(tmp_path):
    tiles = grid(5, 20, lambda x, y: f"{x}/{y}".encode()) + grid(3, 4, lambda x, y: b"coarse")
    parts = [(address, b"+") for address, _ in tiles[::3]]
    count, source = archive(tmp_path, [*reversed(tiles), *parts])
    reader = Reader(source)
    assert count == len(tiles) == reader.header()["addressed_tiles_count"]
    extended = {address for address, _ in parts}
    for address, data in tiles:
        assert gzip.decompress(reader.get(*address)) == data + (b"+" if address in extended else b"")
    assert reader.get(5, 31, 31) is None
    assert reader.metadata() == {"zooms": [3, 5]}
    header = reader.header()
    assert (header["min_zoom"], header["max_zoom"], header["tile_type"], header["clustered"]) == (3, 5, TileType.MVT, True)
    assert (header["min_lon_e7"], header["max_lat_e7"]) == (80_000_000, 490_000_000)
    ids = [zxy_to_tileid(*zxy) for zxy, _ in all_tiles(source)]
    assert ids == sorted(ids)


def test_equal_tiles_are_kept_once_and_in_runs(tmp_path):
    count, source = archive(tmp_path, grid(4, 16, lambda x, y: b"sea" if y < 8 else f"{x},{y}".encode()), "image/png")
    header = Reader(source).header()
    assert count == 256
    assert header["tile_contents_count"] == 129
    assert header["tile_entries_count"] < 256
    assert Reader(source).get(4, 3, 3) == b"sea"
    assert Reader(source).get(4, 3, 9) == b"3,9"


def test_many_tiles_have_leaf_directories_and_the_root_stays_within_its_bytes(tmp_path):
    _, source = archive(tmp_path, grid(8, 160, lambda x, y: f"{x * 7919 % 1009}{'.' * (y % 23)}".encode()), "image/webp")
    header = Reader(source).header()
    assert header["leaf_directory_length"] > 0
    assert HEADER.size + header["root_length"] <= 16_384
    assert Reader(source).get(8, 123, 77) == f"{123 * 7919 % 1009}{'.' * (77 % 23)}".encode()
    assert sum(1 for _ in all_tiles(source)) == 160 * 160


def test_an_empty_archive_is_an_archive(tmp_path):
    count, source = archive(tmp_path, [])
    assert count == 0
    assert [*all_tiles(source)] == []
