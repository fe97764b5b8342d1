"""Measures of areas on a made street: a road and a sidewalk beside it, true and shifted."""

import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.evaluation.areas import NONE, class_raster, score_areas, true_border
from wayloom.ground.areas.find import Area

ROAD, SIDEWALK, TERRAIN = (CLASS_ID[name] for name in ("road", "sidewalk", "terrain"))
CORNER = np.array([-20, 30])
LOW = CORNER * 0.1


def square(column: int, x0: float, x1: float, y1: float = 6.0) -> Area:
    """From x0 to x1 and from 0 to y1, m from the raster's corner."""
    ring = LOW + np.array([[x0, 0.0], [x1, 0.0], [x1, y1], [x0, y1]])
    return Area(column, (ring,), (x1 - x0) * y1, 1.0)


@pytest.fixture
def true() -> np.ndarray:
    """6 x 8 m: a road to x = 4 m, a sidewalk beyond."""
    classes = np.full((60, 80), ROAD, np.uint8)
    classes[:, 40:] = SIDEWALK
    return classes


def test_a_raster_of_areas_has_the_class_of_each_cells_middle_and_leaves_holes_out() -> None:
    hole = LOW + np.array([[1.0, 1.0], [1.0, 2.0], [2.0, 2.0], [2.0, 1.0]])
    holed = Area(0, (*square(0, 0.0, 4.0).rings, hole), 23.0, 1.0)
    found = class_raster([holed, square(1, 4.0, 8.0, 3.0)], CORNER, (60, 80))
    assert (found[:, :40] == ROAD).sum() == pytest.approx(2300, abs=60)
    assert (found[10:20, 10:20] == NONE).sum() >= 64
    assert (found[:29, 41:] == SIDEWALK).all()
    assert (found[31:, 41:] == NONE).all()


def test_areas_that_are_right_have_no_errors(true: np.ndarray) -> None:
    found = score_areas([square(0, 0.0, 4.0), square(1, 4.0, 8.0)], true, CORNER, ROAD, (SIDEWALK,))
    assert found.iou == {ROAD: pytest.approx(1.0, abs=0.02), SIDEWALK: pytest.approx(1.0, abs=0.02)}
    assert np.percentile(found.border_m, 95) <= 0.05  # half a step between the middles of the true edges
    assert (found.covered, found.right) == (1.0, pytest.approx(1.0, abs=0.01))
    assert found.found == 1.0


def test_a_border_that_is_moved_is_off_by_as_much_and_costs_both_classes(true: np.ndarray) -> None:
    found = score_areas([square(0, 0.0, 4.5), square(1, 4.5, 8.0)], true, CORNER, ROAD, (SIDEWALK,))
    assert np.median(found.border_m) == pytest.approx(0.5, abs=0.03)
    assert found.found == 0.0
    assert found.iou == {ROAD: pytest.approx(4.0 / 4.5, abs=0.02), SIDEWALK: pytest.approx(3.5 / 4.0, abs=0.02)}


def test_what_the_truth_does_not_show_is_not_judged_and_what_has_no_area_is_missed(true: np.ndarray) -> None:
    true[:, 60:] = NONE
    found = score_areas([square(0, 0.0, 4.0)], true, CORNER, ROAD, (SIDEWALK,))
    assert found.iou == {ROAD: pytest.approx(1.0, abs=0.02), SIDEWALK: 0.0}
    assert found.covered == pytest.approx(4.0 / 6.0, abs=0.01)
    assert (len(found.border_m), found.found) == (0, 0.0)
    unseen = score_areas([square(0, 0.0, 4.0), square(1, 4.0, 6.0), square(2, 6.0, 8.0)], true, CORNER, ROAD, (SIDEWALK,))
    assert unseen.iou[SIDEWALK] == pytest.approx(1.0, abs=0.03)


def test_where_there_is_no_true_border_none_is_missed(true: np.ndarray) -> None:
    true[:] = ROAD
    found = score_areas([square(0, 0.0, 4.0), square(1, 4.0, 8.0)], true, CORNER, ROAD, (SIDEWALK,))
    assert len(found.border_m) == 0
    assert np.isnan(found.found)


def test_the_true_border_lies_between_the_cells(true: np.ndarray) -> None:
    border = true_border(true, CORNER, ROAD, (SIDEWALK,))
    assert len(border) == 60
    np.testing.assert_allclose(border[:, 0], LOW[0] + 4.0)
