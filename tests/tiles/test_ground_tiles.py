"""Raster tiles of the ground: codecs, coarser levels, updates that equal what is cut at once, and their descriptions."""

import xml.etree.ElementTree as ET
from collections.abc import Collection
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from ground.made_sheets import Street, cut
from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.ground_map import GroundMap
from wayloom.ground.kernels import rendering
from wayloom.ground.merge import merge_sheets
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges
from wayloom.tiles.descriptions import SUFFIXES, tile_json, wmts_capabilities
from wayloom.tiles.formats import SERVED_LAYERS, Tile
from wayloom.tiles.grid import EQUATOR_M, TileAddress, pixel_from_lonlat
from wayloom.tiles.ground_tiles import ground_tiles, touched_rasters
from wayloom.tiles.mvt import CELLS_LAYER, TRACKS_LAYER
from wayloom.tiles.rasters import (
    HEIGHT,
    ORTHO,
    RASTER_LAYERS,
    RASTER_PX,
    SURFACE,
    decode_picture,
    heights_of,
    heights_picture,
)
from wayloom.tiles.settings import TileSettings

FRAME = MapFrame(8.4, 49.0, 100.0)
SETTINGS = TileSettings(min_zoom=15)
STREET = Street()
Tiles = dict[tuple[str, int, int, int], Tile]


class Held:
    """Regions in memory as the source of their tiles, and tiles of before."""

    def __init__(self, regions: dict[RegionKey, GroundMap], before: Tiles | None = None) -> None:
        self.regions, self.before = regions, before or {}

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        return getattr(self.regions[key], name) if key in self.regions else None

    def tile(self, layer: str, address: TileAddress) -> bytes | None:
        found = self.before.get((layer, *address))
        return None if found is None else found.data


def regions_of(first_m: float, last_m: float, keys: Collection[RegionKey], **how: object) -> dict[RegionKey, GroundMap]:
    sheets = [cut(STREET, x, x + 42.0, seed=k, **how) for k, x in enumerate(np.arange(first_m, last_m, 40.0).tolist())]  # type: ignore[arg-type]
    made = {key: merge_sheets(sheets, region_edges(key)[0], REGION_M) for key in keys}
    return {key: one for key, one in made.items() if one is not None}


def cut_tiles(changed: Collection[RegionKey], source: Held) -> Tiles:
    return {(tile.layer, tile.z, tile.x, tile.y): tile for tile in ground_tiles(changed, source, FRAME, SETTINGS)}


@pytest.fixture(scope="module")
def street() -> dict[RegionKey, GroundMap]:
    return regions_of(10.0, 130.0, [(0, 0), (1, 0), (2, 0)])


@pytest.fixture(scope="module")
def cut_once(street: dict[RegionKey, GroundMap]) -> Tiles:
    return cut_tiles(street, Held(street))


def test_a_pyramid_that_was_updated_is_the_one_cut_at_once(street: dict[RegionKey, GroundMap], cut_once: Tiles) -> None:
    first = {key: street[key] for key in ((0, 0),)}
    tiles = cut_tiles(first, Held(first))
    new = [(1, 0), (2, 0)]
    tiles |= cut_tiles(new, Held(street, tiles))
    assert tiles == cut_once
    assert {key[0] for key in cut_once} == set(RASTER_LAYERS)


def test_threads_change_neither_a_tile_nor_their_order(street: dict[RegionKey, GroundMap], cut_once: Tiles) -> None:
    first = {key: street[key] for key in ((0, 0),)}
    before = cut_tiles(first, Held(first))
    for changed, source in ((street, Held(street)), ([(1, 0), (2, 0)], Held(street, before))):
        one, three = (list(ground_tiles(changed, source, FRAME, SETTINGS, threads)) for threads in (1, 3))
        assert three == one
    assert len(one) < len(cut_once)


def test_what_has_gone_leaves_no_tile(street: dict[RegionKey, GroundMap], cut_once: Tiles) -> None:
    left = {key: street[key] for key in ((0, 0), (1, 0))}
    after = cut_tiles([(2, 0)], Held(left, cut_once))
    scope = {(layer, *one) for (layer, _), members in touched_rasters([(2, 0)], FRAME, SETTINGS).items() for one in members}
    kept = {key: tile for key, tile in cut_once.items() if key not in scope} | after
    assert after.keys() <= scope
    assert kept == cut_tiles(left, Held(left))


def test_a_change_touches_its_own_tiles_and_one_way_up(street: dict[RegionKey, GroundMap]) -> None:
    scope = touched_rasters([(1, 0)], FRAME, SETTINGS)
    assert {key[0] for key in scope} == set(RASTER_LAYERS)
    assert len(scope[ORTHO, 20]) <= 25
    assert len(scope[ORTHO, 15]) <= 2
    assert touched_rasters([], FRAME, SETTINGS)[ORTHO, 20] == frozenset()


def test_no_tile_is_larger_than_a_megabyte_however_rough_the_ground() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (RASTER_PX, RASTER_PX, 4)).astype(np.uint8)
    assert all(len(layer.codec.encode(noise)) < 1_100_000 for layer in RASTER_LAYERS.values())
    assert len(RASTER_LAYERS[ORTHO].codec.encode(noise)) < 1_000_000


def test_a_tile_shows_the_street_in_true_size(cut_once: Tiles) -> None:
    """The dash from 66 to 69 m: its ends in pixels of the finest zoom."""
    ends = [(66.0, 30.0, float(STREET.height(np.array(66.0), np.array(30.0)))), (69.0, 30.0, 1.4)]
    lon_lat = wgs84.lonlatheight_from_enu(np.array(ends), FRAME)[:, :2]
    (west, row), (east, _) = pixel_from_lonlat(lon_lat, 21).tolist()
    line = []
    for column in range(west - 20, east + 20):
        tile = cut_once[ORTHO, 20, column // 512, row // 512]
        line.append(decode_picture(tile.data)[row % 512, column % 512, 0])
    bright = np.flatnonzero(np.array(line) > 160)
    assert abs(int(bright[0]) - 20) <= 2
    assert abs(int(bright[-1]) - (len(line) - 20)) <= 2


def test_coarser_pixels_are_means_of_what_is_seen() -> None:
    picture = np.zeros((2, 4, 4), np.uint8)
    picture[0, 0], picture[1, 1] = (100, 0, 30, 255), (200, 0, 31, 255)
    picture[0, 1] = (250, 250, 250, 0)
    photo = RASTER_LAYERS[ORTHO].codec.coarser(np.vstack([picture, picture]))
    assert photo[0, 0].tolist() == [150, 0, 31, 128]
    assert photo[0, 1].tolist() == [0, 0, 0, 0]


def test_coarser_heights_are_means_of_the_known_ones_where_two_are() -> None:
    heights = np.full((4, 4), np.nan)
    heights[0, :2] = 10.0, 11.0
    heights[0, 2] = 7.0
    heights[2:, :2] = [[-1.0, -1.0], [-1.0, -5.0]]
    coarse = heights_of(RASTER_LAYERS[HEIGHT].codec.coarser(heights_picture(heights)))
    np.testing.assert_allclose(coarse, [[10.5, np.nan], [-2.0, np.nan]])


def test_heights_are_written_to_a_256th_of_a_metre() -> None:
    heights = np.array([[-430.5, 0.0, 8848.86], [123.456, np.nan, -0.001]])
    back = heights_of(decode_one(RASTER_LAYERS[HEIGHT].codec.encode(heights_picture(heights))))
    np.testing.assert_allclose(back, heights, atol=0.5 / 256.0)
    picture = heights_picture(np.array(100.5))
    assert picture.tolist() == [128, 100, 128, 255]


def decode_one(data: bytes) -> NDArray[np.uint8]:
    """A PNG of any size."""
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGRA2RGBA), np.uint8)


def test_opaque_and_clear_pictures_come_back_with_their_alpha() -> None:
    opaque = np.full((RASTER_PX, RASTER_PX, 4), 255, np.uint8)
    assert (decode_picture(RASTER_LAYERS[ORTHO].codec.encode(opaque))[..., 3] == 255).all()
    half = opaque.copy()
    half[:, 100:, 3] = 0
    np.testing.assert_array_equal(decode_picture(RASTER_LAYERS[ORTHO].codec.encode(half))[..., 3], half[..., 3])
    with pytest.raises(InputError, match="stitched anew"):
        decode_picture(b"RIFF")


@pytest.mark.kernels
def test_rendering_is_that_of_a_plain_loop() -> None:
    rng = np.random.default_rng(1)
    colour, seen = rng.integers(0, 256, (9, 8, 3)).astype(np.uint8), rng.random((9, 8)) > 0.3
    height = rng.integers(0, 60, (9, 8)).astype(np.int32)
    height[rng.random((9, 8)) > 0.8] = -1
    x, y = rng.uniform(-1.0, 9.0, (2, 6, 5))
    out, up, nearest = np.zeros((6, 5, 4), np.uint8), np.empty((6, 5)), np.zeros((6, 5), np.uint8)
    rendering.draw_colour(colour, seen, x, y, out)
    rendering.draw_height(height, -1, x, y, up)
    rendering.draw_nearest(colour[..., 0].copy(), 7, x, y, nearest)
    for i, j in np.ndindex(6, 5):
        column, row = int(np.floor(x[i, j] + 0.5)), int(np.floor(y[i, j] + 0.5))
        inside = 0 <= row < 9 and 0 <= column < 8
        assert nearest[i, j] == (colour[row, column, 0] if inside else 7)
        corners = [
            (r, c, (1 - abs(x[i, j] - c)) * (1 - abs(y[i, j] - r)))
            for r in (int(np.floor(y[i, j])), int(np.floor(y[i, j])) + 1)
            for c in (int(np.floor(x[i, j])), int(np.floor(x[i, j])) + 1)
            if 0 <= r < 9 and 0 <= c < 8
        ]
        if inside and seen[row, column]:
            held = [(w, colour[r, c].astype(float)) for r, c, w in corners if seen[r, c]]
            mean = sum(w * value for w, value in held) / sum(w for w, _ in held)
            assert np.abs(out[i, j, :3] - mean).max() <= 0.5 + 1e-9
            assert out[i, j, 3] == 255
        else:
            assert out[i, j].tolist() == [0, 0, 0, 0]
        if inside and height[row, column] != -1:
            own = height[row, column]
            known = [(w, height[r, c]) for r, c, w in corners if height[r, c] != -1 and abs(height[r, c] - own) <= 40]
            assert up[i, j] == pytest.approx(sum(w * z for w, z in known) / sum(w for w, _ in known) / 1000.0)
        else:
            assert np.isnan(up[i, j])


LAYERS = {
    "ortho": {"media_type": "image/webp", "min_zoom": 12, "max_zoom": 20},
    "height": {"media_type": "image/png", "min_zoom": 12, "max_zoom": 19},
    "semantic": {"media_type": "image/png", "min_zoom": 12, "max_zoom": 20},
    "features": {"media_type": "application/vnd.mapbox-vector-tile", "min_zoom": 12, "max_zoom": 18},
}


def test_every_served_layer_has_its_ending() -> None:
    assert set(SERVED_LAYERS) <= SUFFIXES.keys()
    assert [SUFFIXES[name] for name in (ORTHO, HEIGHT, SURFACE, "parked", "features")] == [".webp", ".png", ".png", ".png", ".mvt"]


def test_tile_json_tells_what_a_viewer_needs() -> None:
    said = tile_json("height", LAYERS["height"], (8.0, 49.0, 8.1, 49.1), "http://x/{z}/{x}/{y}")
    assert (said["tiles"], said["tileSize"], said["encoding"]) == (["http://x/{z}/{x}/{y}.png"], 512, "terrarium")
    assert (said["tilejson"], said["minzoom"], said["maxzoom"], said["bounds"]) == ("3.0.0", 12, 19, [8.0, 49.0, 8.1, 49.1])
    assert [one["id"] for one in tile_json("features", LAYERS["features"], None, "")["vector_layers"]] == [
        CELLS_LAYER,
        TRACKS_LAYER,
    ]
    assert tile_json("semantic", LAYERS["semantic"], (179.9, 1.0, -179.9, 2.0), "")["bounds"] == [-180.0, 1.0, 180.0, 2.0]


def test_wmts_capabilities_list_the_pictures_with_their_matrices() -> None:
    text = wmts_capabilities("a & b", LAYERS, (8.0, 49.0, 8.1, 49.1), "http://x/{layer}/{z}/{x}/{y}")
    names = {"w": "http://www.opengis.net/wmts/1.0", "ows": "http://www.opengis.net/ows/1.1"}
    root = ET.fromstring(text.encode())
    layers = {one.findtext("ows:Identifier", namespaces=names): one for one in root.findall("w:Contents/w:Layer", names)}
    assert sorted(str(name) for name in layers) == ["height", "ortho", "semantic"]
    address = layers["ortho"].find("w:ResourceURL", names)
    assert address is not None
    assert address.attrib["template"] == "http://x/ortho/{TileMatrix}/{TileCol}/{TileRow}.webp"
    sets = root.findall("w:Contents/w:TileMatrixSet", names)
    assert [one.findtext("ows:Identifier", namespaces=names) for one in sets] == ["WebMercator256", "WebMercator512"]
    matrix = sets[1].findall("w:TileMatrix", names)[20]
    scale = float(str(matrix.findtext("w:ScaleDenominator", namespaces=names)))
    assert scale * 0.00028 == pytest.approx(EQUATOR_M / 2**29)
