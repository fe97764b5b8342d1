"""Places on both sides of the antimeridian are neighbours."""

import numpy as np
import pytest

from wayloom.geodesy.antimeridian import box_of, line_geometry, median_place, union_of


@pytest.mark.parametrize("shift", [0.0, 8.4, 179.9999, 180.0, -179.9998])
def test_the_median_of_neighbours_lies_among_them_wherever_they_are(shift: float) -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 7, 8):
        lon = shift + rng.uniform(-1e-3, 1e-3, count)
        place = median_place(np.column_stack([(lon + 180.0) % 360.0 - 180.0, np.full(count, 49.0), np.full(count, 5.0)]))
        assert (place.lon_deg - np.median(lon) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
        assert -180.0 <= place.lon_deg <= 180.0
        assert (place.lat_deg, place.height_m) == (49.0, 5.0)


def test_a_box_across_the_antimeridian_is_small_and_goes_on_eastwards() -> None:
    west, south, east, north = box_of(np.array([[179.9, 1.0], [-179.8, 2.0], [179.95, 1.5]]))
    assert (west, south, north) == (pytest.approx(179.9), 1.0, 2.0)
    assert east == pytest.approx(180.2)
    assert box_of(np.array([[8.0, 49.0], [8.5, 49.5]])) == (8.0, 49.0, 8.5, 49.5)


def test_the_union_of_boxes_on_both_sides_spans_what_they_span() -> None:
    assert union_of([(179.9, 1.0, 179.95, 2.0), (-179.9, 0.0, -179.8, 1.0)]) == pytest.approx((179.9, 0.0, 180.2, 2.0))
    assert union_of([(-179.9, 0.0, -179.8, 1.0), (179.9, 1.0, 180.1, 2.0)]) == pytest.approx((179.9, 0.0, 180.2, 2.0))
    assert union_of([(8.0, 49.0, 8.1, 49.1), (8.3, 48.9, 8.4, 49.0)]) == pytest.approx((8.0, 48.9, 8.4, 49.1))


def test_a_way_over_the_antimeridian_is_cut_there_on_the_straight_line() -> None:
    way = [[179.999, 1.0, 10.0], [-179.999, 3.0, 20.0], [-179.998, 3.0, 20.0]]
    cut = line_geometry(way)
    assert cut["type"] == "MultiLineString"
    assert cut["coordinates"] == [
        [way[0], [180.0, 2.0, 15.0]],
        [[-180.0, 2.0, 15.0], way[1], way[2]],
    ]
    back = line_geometry(way[::-1])
    assert back["coordinates"][0][-1][0] == -180.0
    assert back["coordinates"][1][0] == [180.0, 2.0, 15.0]
    assert line_geometry(way[1:]) == {"type": "LineString", "coordinates": way[1:]}
