"""Polygons of GeoJSON hold the places that they enclose, wherever on Earth, and say what is wrong with them."""

from typing import Any

import numpy as np
import pytest
from shapely.geometry import Point, shape

from wayloom.errors import InputError
from wayloom.exclusion.areas import area_of_geometry, areas_of_geojson

STAR = [[0.0, 0.0], [4.0, 1.0], [8.0, 0.0], [7.0, 4.0], [8.0, 8.0], [4.0, 6.0], [0.0, 8.0], [1.0, 4.0], [0.0, 0.0]]
HOLE = [[3.0, 3.0], [5.0, 3.0], [5.0, 5.0], [3.0, 5.0], [3.0, 3.0]]


def at(rings: list[list[list[float]]], lon: float, lat: float, size: float = 1e-4) -> dict[str, Any]:
    """The polygon of some 90 m at a place."""
    turned = [[[(lon + size * x + 180.0) % 360.0 - 180.0, lat + size * y] for x, y in ring] for ring in rings]
    return {"type": "Polygon", "coordinates": turned}


@pytest.mark.parametrize("lon", [8.4, -0.0004, 179.9996])
@pytest.mark.parametrize("lat", [49.0, -70.0])
def test_places_inside_are_those_that_a_slow_twin_finds(lon: float, lat: float) -> None:
    area = area_of_geometry(at([STAR, HOLE], lon, lat))
    unit = np.random.default_rng(0).uniform(-2.0, 10.0, (800, 2))
    lon_lat = np.column_stack([(lon + 1e-4 * unit[:, 0] + 180.0) % 360.0 - 180.0, lat + 1e-4 * unit[:, 1]])
    twin = shape({"type": "Polygon", "coordinates": [STAR, HOLE]})
    expected = [twin.contains(Point(place)) for place in unit]
    assert area.contains(lon_lat).tolist() == expected
    assert 100 < sum(expected) < 700


def test_a_margin_widens_an_area_by_its_metres() -> None:
    area = area_of_geometry(at([STAR], 8.4, 49.0))
    metres = np.arange(1.0, 30.0)
    west = np.column_stack([8.4 + 1e-4 - metres / (111_320.0 * np.cos(np.radians(49.0))), np.full(29, 49.0004)])
    found = area.contains(west, 10.0)
    assert found[:9].all()
    assert not found[10:].any()
    assert not area.contains(west).any()


def test_a_multipolygon_holds_what_each_of_its_polygons_holds() -> None:
    two = [at([STAR], 8.4, 49.0)["coordinates"], at([STAR], 8.41, 49.0)["coordinates"]]
    area = area_of_geometry({"type": "MultiPolygon", "coordinates": two})
    assert area.contains(np.array([[8.4004, 49.0004], [8.4104, 49.0004], [8.405, 49.0004]])).tolist() == [True, True, False]


def test_features_bring_their_names() -> None:
    feature = {"type": "Feature", "properties": {"name": "yard"}, "geometry": at([STAR], 8.4, 49.0)}
    bare = {**feature, "properties": None}
    found = areas_of_geojson({"type": "FeatureCollection", "features": [feature, bare]})
    assert [name for name, _ in found] == ["yard", ""]
    assert [geometry for _, geometry in found] == 2 * [feature["geometry"]]


def test_what_is_stored_has_two_numbers_a_corner_closed_rings_and_a_name_that_every_database_takes() -> None:
    ring = [[8, 49, float("nan")], [9, 49, "high"], [9, 50]]
    feature = {
        "type": "Feature",
        "properties": {"name": "ya\0rd\ud800" + "x" * 300},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    ((name, geometry),) = areas_of_geojson(feature)
    assert name == "yard" + "x" * 252
    assert geometry == {"type": "Polygon", "coordinates": [[[8.0, 49.0], [9.0, 49.0], [9.0, 50.0], [8.0, 49.0]]]}
    many = {"type": "MultiPolygon", "coordinates": [[ring], [ring]]}
    assert areas_of_geojson(many)[0][1]["coordinates"] == 2 * [geometry["coordinates"]]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ([], "None, no Polygon"),
        ({"type": "Point", "coordinates": [8.0, 49.0]}, "'Point', no Polygon"),
        ({"type": "Polygon", "coordinates": []}, "no ring"),
        ({"type": "Polygon", "coordinates": [[[8.0, 49.0], [8.1, 49.0], [8.0, 49.0]]]}, "fewer than three"),
        ({"type": "Polygon", "coordinates": [[[8.0, 49.0], [8.1, float("nan")], [8.2, 49.1]]]}, "no longitude and latitude"),
        ({"type": "Polygon", "coordinates": [[[49.0, 800.0], [8.1, 49.0], [8.2, 49.1]]]}, "no longitude and latitude"),
        ({"type": "Polygon", "coordinates": "everywhere"}, "not rings"),
        ({"type": "Polygon", "coordinates": [[[-80.0, 0.0], [80.0, 0.0], [0.0, 10.0]]]}, "degrees wide"),
        ({"type": "FeatureCollection"}, "list of features"),
        ({"type": "Polygon", "coordinates": [[[k / 1e5, (k % 2) / 10] for k in range(10_001)]]}, "corners"),
    ],
)
def test_what_is_no_area_is_refused_in_words(content: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        areas_of_geojson(content)
