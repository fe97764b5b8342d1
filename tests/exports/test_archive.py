"""PMTiles and folders of tiles of a map: what the tile server would serve."""

import gzip
import json

import mapbox_vector_tile
import pytest
from pmtiles.reader import MmapSource, Reader, all_tiles

from exports.made_sources import made_source
from wayloom.errors import InputError
from wayloom.exports.archive import write_archive
from wayloom.exports.tileset_folder import write_tile_folder, write_tileset
from wayloom.geodesy import wgs84
from wayloom.tiles.gltf_points import decode_glb
from wayloom.tiles.pyramid import build_tiles

SPAN = 0.0002
"""Degrees, some 15 m."""


@pytest.fixture(scope="module")
def city():
    return made_source(600, extent_m=40.0)


@pytest.fixture(scope="module")
def served(city):
    """What a service would serve of it."""
    return {(t.layer, t.z, t.x, t.y): t.data for t in build_tiles(city.whole, city.frame, tracks=[*city.tracks()])}


def archived(path):
    with path.open("rb") as file:
        source = MmapSource(file)
        return Reader(source).header(), Reader(source).metadata(), dict(all_tiles(source))


@pytest.mark.parametrize(("layer", "kept"), [("vector", "features"), ("semantic", "semantic")])
def test_an_archive_holds_the_tiles_that_a_service_would_serve(city, tmp_path, served, layer, kept):
    count = write_archive(tmp_path / "a.pmtiles", city, None, layer, city.provenance())
    header, metadata, tiles = archived(tmp_path / "a.pmtiles")
    data = {address: gzip.decompress(one) if layer == "vector" else one for address, one in tiles.items()}
    assert data == {key[1:]: one for key, one in served.items() if key[0] == kept}
    assert count == len(tiles)
    assert metadata["provenance"] == city.provenance()
    assert header["min_zoom"] == 12
    assert header["min_lon_e7"] / 1e7 < 8.39 < header["max_lon_e7"] / 1e7


def test_vector_tiles_of_drives_with_ground_show_their_markings_too(street, tmp_path):
    write_archive(tmp_path / "a.pmtiles", street, None, "vector", {})
    _, metadata, tiles = archived(tmp_path / "a.pmtiles")
    assert [one["id"] for one in metadata["vector_layers"]] == ["semantic", "coverage", "markings", "kerbs", "areas", "objects"]
    finest = [mapbox_vector_tile.decode(gzip.decompress(data)) for (z, _, _), data in tiles.items() if z == 18]
    assert {name for tile in finest for name in tile} == {"semantic", "coverage", "markings", "kerbs", "areas", "objects"}
    assert sum(len(tile["markings"]["features"]) for tile in finest if "markings" in tile) >= 12


def test_a_raster_archive_holds_the_photograph(street, tmp_path):
    write_archive(tmp_path / "a.pmtiles", street, None, "height", {})
    header, metadata, tiles = archived(tmp_path / "a.pmtiles")
    assert (header["min_zoom"], header["max_zoom"]) == (12, 19)
    assert (metadata["encoding"], metadata["tileSize"]) == ("terrarium", 512)
    assert all(data.startswith(b"\x89PNG") for data in tiles.values())


def test_an_unknown_layer_lists_the_known_ones(city, tmp_path):
    with pytest.raises(InputError, match="vector, semantic, ortho"):
        write_archive(tmp_path / "a.pmtiles", city, None, "streets", {})


def contents(file):
    """Geometric error and file of every content below a tileset, links followed."""
    tiles = [json.loads(file.read_text())["root"]]
    while tiles:
        tile = tiles.pop()
        tiles += tile.get("children", ())
        uri = (file.parent / tile["content"]["uri"]).resolve() if "content" in tile else None
        if uri is not None and uri.suffix == ".json":
            yield from contents(uri)
        elif uri is not None:
            yield tile["geometricError"], uri


def test_a_tileset_holds_every_voxel_and_its_provenance(city, tmp_path):
    write_tileset(tmp_path / "city", city, None, city.provenance())
    root = json.loads((tmp_path / "city" / "tileset.json").read_text())
    assert root["asset"]["version"] == "1.1"
    assert root["asset"]["extras"]["provenance"] == city.provenance()
    finest = [file for error, file in contents(tmp_path / "city" / "tileset.json") if error == 0.0]
    assert sum(len(decode_glb(file.read_bytes())) for file in finest) == len(city.whole)


def test_a_folder_of_tiles_holds_what_a_service_would_serve(city, tmp_path, served):
    count = write_tile_folder(tmp_path / "tiles", city, None, city.provenance())
    found = {file.relative_to(tmp_path / "tiles").with_suffix("").as_posix(): file.read_bytes()
             for file in (tmp_path / "tiles").glob("*/*/*/*")}  # fmt: skip
    assert found == {"/".join(map(str, key)): data for key, data in served.items()}
    assert count == len(found)
    assert json.loads((tmp_path / "tiles" / "provenance.json").read_text()) == city.provenance()


def test_a_folder_that_holds_something_is_left_alone(city, tmp_path):
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "mine").write_text("mine")
    with pytest.raises(OSError, match="tiles"):
        write_tile_folder(tmp_path / "tiles", city, None, {})
    assert [*tmp_path.rglob("*")] == [tmp_path / "tiles", tmp_path / "tiles" / "mine"]


def test_tiles_are_cut_to_a_box(city, tmp_path):
    middle = wgs84.lonlatheight_from_enu(city.whole.points_enu, city.frame)[:, :2].mean(axis=0)
    box = (middle[0], middle[1], middle[0] + SPAN, middle[1] + SPAN)
    write_archive(tmp_path / "a.pmtiles", city, box, "vector", {})
    _, _, tiles = archived(tmp_path / "a.pmtiles")
    finest = [mapbox_vector_tile.decode(gzip.decompress(data)) for (z, _, _), data in tiles.items() if z == 12]
    counted = sum(one["properties"]["count"] for tile in finest for one in tile["semantic"]["features"])
    lon_lat = wgs84.lonlatheight_from_enu(city.whole.points_enu, city.frame)[:, :2]
    assert counted == ((lon_lat >= middle) & (lon_lat <= middle + SPAN)).all(axis=1).sum() > 20
