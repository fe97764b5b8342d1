"""Coverage follows the streets: what is near a track is in it, what is not is not."""

import itertools
import math

import cv2
import numpy as np
import pytest

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.tiles.coverage import CUT_ZOOM, covered_areas, visited_squares
from wayloom.tiles.grid import metres_per_pixel, pixel_from_lonlat, tile_bounds

FRAME = MapFrame(8.39, 48.98, 115.0)
PIXEL_M = metres_per_pixel(CUT_ZOOM + 3, 48.98)


def lon_lat(enu: list[list[float]]) -> np.ndarray:
    points = np.column_stack([np.array(enu, float), np.zeros(len(enu))])
    return wgs84.lonlatheight_from_enu(points, FRAME)[:, :2]


def metres(ring: list[list[float]]) -> np.ndarray:
    places = np.column_stack([np.array(ring), np.full(len(ring), FRAME.height_m)])
    return wgs84.enu_from_lonlatheight(places, FRAME)[:, :2]


def depth_m(areas, enu: list[float]) -> float:
    """How far inside of the areas a place lies; below zero: outside."""
    found = []
    for rings in areas:
        outline, *holes = (metres(ring).astype(np.float32) for ring in rings)
        inside = cv2.pointPolygonTest(outline, enu, True)
        found.append(min([inside, *(-cv2.pointPolygonTest(hole, enu, True) for hole in holes)]))
    return max(found)


def area_m2(areas) -> float:
    return sum(
        cv2.contourArea(metres(rings[0]).astype(np.float32))
        - sum(cv2.contourArea(metres(hole).astype(np.float32)) for hole in rings[1:])
        for rings in areas
    )


def test_a_street_is_covered_to_both_sides_and_no_further():
    areas = list(covered_areas([lon_lat([[0.0, 0.0], [300.0, 100.0]])], 10.0))
    along = np.array([300.0, 100.0])
    across = np.array([-100.0, 300.0]) / math.hypot(100.0, 300.0)
    for share, beside in itertools.product((0.1, 0.5, 0.9), (-1.0, 0.0, 1.0)):
        assert depth_m(areas, list(share * along + 7.0 * beside * across)) > 0
        if beside:
            assert depth_m(areas, list(share * along + 13.0 * beside * across)) < 0
    length = math.hypot(300.0, 100.0)
    assert abs(area_m2(areas) - (length * 20.0 + math.pi * 100.0)) < (2.0 * length + 80.0) * PIXEL_M


def test_a_block_that_drives_went_around_is_a_hole():
    around = lon_lat([[0, 500], [150, 500], [150, 650], [0, 650], [0, 500]])  # off the edge of two tiles
    areas = list(covered_areas([around]))
    assert [len(rings) for rings in areas] == [2]
    assert depth_m(areas, [75.0, 575.0]) < -50.0
    assert depth_m(areas, [75.0, 502.0]) > 5.0


def test_a_street_over_the_edge_of_a_tile_has_no_gap():
    column = int(pixel_from_lonlat(np.array([[8.39, 48.98]]), CUT_ZOOM)[0, 0]) // 256 + 1
    edge = column / (1 << CUT_ZOOM) * 360.0 - 180.0
    areas = list(covered_areas([np.array([[edge - 0.001, 48.98], [edge + 0.001, 48.98]])]))
    assert len(areas) == 2
    reached = sorted((min(ring[0] for ring in rings[0]), max(ring[0] for ring in rings[0])) for rings in areas)
    assert reached[0][1] == pytest.approx(edge, abs=1e-7)
    assert reached[1][0] == pytest.approx(edge, abs=1e-7)


def test_a_street_over_the_antimeridian_goes_not_around_the_world():
    areas = list(covered_areas([np.array([[179.9995, 0.0], [-179.9995, 0.0]])]))
    assert max(abs(place[0]) for rings in areas for place in rings[0]) <= 180.0
    assert all(max(p[0] for p in rings[0]) - min(p[0] for p in rings[0]) < 0.01 for rings in areas)


def test_the_same_street_twice_is_covered_once():
    street = lon_lat([[0.0, 0.0], [200.0, 0.0]])
    assert list(covered_areas([street, street])) == list(covered_areas([street]))
    assert list(covered_areas([])) == []


def test_squares_along_the_drives_count_each_drive_once_and_tell_when_the_last_one_came():
    east, north = lon_lat([[0.0, 0.0], [300.0, 0.0]]), lon_lat([[150.0, -200.0], [150.0, 200.0]])
    squares = visited_squares([("a", 10.0, east), ("a", 30.0, east), ("b", 20.0, north)])
    inside = {address: (drives, last_s) for address, drives, last_s in squares}
    assert len({address.z for address in inside}) == 1

    def at(place: list[float]) -> list[tuple[int, float]]:
        lon, lat = lon_lat([place])[0]
        boxes = ((tile_bounds(address), said) for address, said in inside.items())
        return [said for (west, south, right, top), said in boxes if west <= lon < right and south <= lat < top]

    assert at([20.0, 0.0]) == [(1, 30.0)]
    assert at([150.0, 0.0]) == [(2, 30.0)]
    assert at([150.0, 190.0]) == [(1, 20.0)]
    assert at([20.0, 100.0]) == []


def test_squares_get_wider_where_there_are_too_many_and_go_over_the_antimeridian_the_short_way():
    track = np.array([[179.99, 10.0], [-179.99, 10.0]])
    fine, coarse = visited_squares([("a", 0.0, track)]), visited_squares([("a", 0.0, track)], most=20)
    assert 58 <= len(fine) <= 61  # 0.02 degrees of 360 / 2 ** 20 each
    assert len(coarse) <= 20
    assert {address.z for address, _, _ in coarse} == {18}
    assert sum(drives for _, drives, _ in coarse) == len(coarse)
