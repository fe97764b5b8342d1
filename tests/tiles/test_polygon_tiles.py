"""Polygons and points in tiles: clipped to each, wound as the specification wants, gone where nothing is left."""

import mapbox_vector_tile
import numpy as np
import pytest
from shapely.geometry import Polygon, box

from wayloom.tiles import protobuf
from wayloom.tiles.grid import lonlat_from_unit
from wayloom.tiles.mvt import BUFFER, EXTENT
from wayloom.tiles.polygons import clip_ring, tiles_of_point, tiles_of_polygon

ZOOM, X, Y = 18, 137_000, 90_000


def degrees(*places: tuple[float, float]) -> np.ndarray:
    """Of tile units of tile X, Y; y down."""
    return lonlat_from_unit((np.array(places) / EXTENT + (X, Y)) / (1 << ZOOM))


def ring(*places: tuple[float, float]) -> np.ndarray:
    return degrees(*places, places[0])


OUTER = ((1000, 3000), (6000, 3000), (6000, 500), (1000, 500))
"""Counter-clockwise on Earth, over two tiles."""
HOLE = ((1500, 1000), (2500, 1000), (2500, 2000), (1500, 2000))


def test_a_polygon_is_cut_to_the_tiles_that_it_touches() -> None:
    found = tiles_of_polygon([ring(*OUTER), ring(*HOLE)], ZOOM)
    assert {(tile.x - X, tile.y - Y) for tile in found} == {(0, 0), (1, 0)}
    whole = Polygon(OUTER, [HOLE])
    for tile, rings in found.items():
        dx = (tile.x - X) * EXTENT
        wanted = whole.intersection(box(dx - BUFFER, -BUFFER, dx + EXTENT + BUFFER, EXTENT + BUFFER))
        drawn = Polygon(rings[0], rings[1:])
        assert drawn.is_valid
        assert drawn.area == pytest.approx(wanted.area, rel=1e-3)
        data = protobuf.layer("areas", EXTENT, protobuf.POLYGON, [(protobuf.polygon(rings), {"kind": "road"})])
        (feature,) = mapbox_vector_tile.decode(data, default_options={"y_coord_down": True})["areas"]["features"]
        assert feature["geometry"]["type"] == "Polygon"
        assert len(feature["geometry"]["coordinates"]) == len(rings) == (2 if tile.x == X else 1)
        assert Polygon(rings[0]).exterior.is_ccw  # y down: clockwise on the screen


def test_what_has_no_area_in_a_tiles_units_is_left_out() -> None:
    assert tiles_of_polygon([ring((10, 10), (10.2, 10), (10.2, 9.8))], ZOOM) == {}


def test_a_ring_is_clipped_as_shapely_clips_it() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
        places = 50.0 + rng.uniform(20.0, 90.0, 9)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        clipped = clip_ring(places, 0.0, 100.0)
        wanted = Polygon(places).intersection(box(0, 0, 100, 100)).area
        x, y = clipped.T if len(clipped) else np.zeros((2, 0))
        assert abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2.0 == pytest.approx(wanted, abs=1e-6)


def test_a_point_near_an_edge_is_in_both_tiles() -> None:
    found = tiles_of_point(degrees((4090, 2000)), ZOOM)
    assert {(tile.x - X, tile.y - Y): place for tile, place in found.items()} == {(0, 0): (4090, 2000), (1, 0): (-6, 2000)}
    data = protobuf.layer("objects", EXTENT, protobuf.POINT, [(protobuf.point(-6, 2000), {"kind": "pole"})])
    (feature,) = mapbox_vector_tile.decode(data, default_options={"y_coord_down": True})["objects"]["features"]
    assert feature["geometry"] == {"type": "Point", "coordinates": [-6, 2000]}
