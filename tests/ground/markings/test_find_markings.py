import numpy as np
import pytest
from drawn_ground import ASPHALT, asphalt, bar, hidden, paint, raster

from wayloom.ground.markings.find import find_markings
from wayloom.ground.markings.types import Marking


def kinds(found: list[Marking]) -> list[str]:
    return sorted(one.kind for one in found)


@pytest.mark.parametrize("angle", [0.0, 0.35, 1.1])
@pytest.mark.parametrize("width", [0.12, 0.25])
def test_a_dash_lies_within_a_centimetre_of_where_it_was_painted(angle: float, width: float) -> None:
    fine = asphalt(16.0, 12.0)
    paint(fine, bar(8.013, 6.021, 3.0, width, angle))
    (found,) = find_markings(raster(fine))
    d, n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    off = found.line[:, :2] - (8.013, 6.021)
    assert found.kind == "dash"
    assert np.abs(off @ n).max() < 0.015
    assert np.abs(np.abs(off @ d) - 1.5).max() < 0.04
    assert found.width_m == pytest.approx(width, abs=0.025)
    assert found.open == (False, False)
    assert found.confidence > 0.9


def test_dashes_in_a_row_stay_apart_and_a_long_line_is_solid() -> None:
    fine = asphalt()
    for x in np.arange(3.0, 28.0, 3.0):
        paint(fine, bar(x, 3.0, 1.0, 0.12))
    paint(fine, bar(15.0, 8.0, 24.0, 0.12))
    found = find_markings(raster(fine))
    assert kinds(found) == ["dash"] * 9 + ["solid"]
    assert max(found, key=lambda one: one.length_m).length_m == pytest.approx(24.0, abs=0.1)


def test_bars_side_by_side_are_a_crossing_with_their_width_and_period() -> None:
    fine = asphalt()
    for y in np.arange(2.0, 9.6, 1.0):
        paint(fine, bar(12.0, y, 4.0, 0.5))
    (found,) = find_markings(raster(fine))
    assert found.kind == "zebra"
    assert found.bars == 8
    assert found.width_m == pytest.approx(0.5, abs=0.03)
    assert found.period_m == pytest.approx(1.0, abs=0.02)
    low, high = found.ring[:, :2].min(axis=0), found.ring[:, :2].max(axis=0)
    np.testing.assert_allclose([*low, *high], [10.0, 1.75, 14.0, 9.25], atol=0.06)


def test_a_broad_line_across_the_lanes_is_a_stop_line_and_along_them_is_not() -> None:
    fine = asphalt()
    for x in np.arange(2.0, 16.0, 3.0):
        paint(fine, bar(x, 6.0, 1.5, 0.12))
    paint(fine, bar(20.0, 3.5, 4.0, 0.5, np.pi / 2))
    paint(fine, bar(8.0, 9.0, 4.0, 0.4))
    found = find_markings(raster(fine))
    assert kinds(found) == ["dash"] * 6 + ["stop_line"]
    (stop,) = (one for one in found if one.kind == "stop_line")
    np.testing.assert_allclose(stop.line[:, 0], 20.0, atol=0.03)


def test_an_arrow_points_along_its_line() -> None:
    fine = asphalt()
    paint(fine, bar(10.0, 6.0, 3.0, 0.15))
    paint(fine, np.array([(11.5, 5.55), (13.2, 6.0), (11.5, 6.45)]))
    (found,) = find_markings(raster(fine))
    assert found.kind == "arrow"
    assert found.line[1, 0] > found.line[0, 0]
    np.testing.assert_allclose(found.line[:, 1], 6.0, atol=0.1)
    assert found.length_m == pytest.approx(4.7, abs=0.3)


def test_a_line_cut_by_the_border_is_open_there() -> None:
    fine = asphalt(16.0, 12.0)
    paint(fine, bar(0.0, 6.0, 8.0, 0.15))
    (found,) = find_markings(raster(fine))
    assert sorted(found.open) == [False, True]
    assert found.line[int(np.argmin(found.line[:, 0])), 0] < 0.2


def test_a_line_goes_on_behind_what_is_hidden() -> None:
    fine = asphalt()
    paint(fine, bar(12.0, 6.0, 14.0, 0.15))
    (found,) = find_markings(hidden(raster(fine), (10.0, 5.0), (11.5, 7.0)))
    assert found.length_m == pytest.approx(14.0, abs=0.1)
    assert found.kind == "solid"


def test_shadows_rails_seams_and_manholes_are_no_markings() -> None:
    fine = asphalt()
    fine[:, : fine.shape[1] // 2] *= 0.4  # the edge of a house's shadow
    paint(fine, bar(22.0, 3.0, 12.0, 0.16), 25.0)  # a rail in its groove
    paint(fine, bar(22.0, 3.0, 12.0, 0.06), 130.0)
    paint(fine, bar(22.0, 6.0, 10.0, 0.05), 40.0)  # a tarred seam
    angle = np.linspace(0, 2 * np.pi, 40)
    paint(fine, np.column_stack([21 + 0.32 * np.cos(angle), 9 + 0.32 * np.sin(angle)]), 35.0)
    paint(fine, np.column_stack([21 + 0.27 * np.cos(angle), 9 + 0.27 * np.sin(angle)]), ASPHALT)
    assert find_markings(raster(fine)) == []


def test_paint_in_a_shadow_is_found_as_well() -> None:
    fine = asphalt()
    for x in np.arange(3.0, 28.0, 3.0):
        paint(fine, bar(x, 6.0, 1.5, 0.15))
    fine[:, : fine.shape[1] // 2] *= 0.35
    assert kinds(find_markings(raster(fine))) == ["dash"] * 9


def test_bare_noisy_asphalt_has_no_markings() -> None:
    assert find_markings(raster(asphalt(), blur_px=1.0, noise=12.0)) == []


def test_the_sigma_across_covers_the_errors() -> None:
    ratios = []
    for seed in range(6):
        fine = asphalt(16.0, 12.0)
        y = 6.0 + 0.013 * seed
        paint(fine, bar(8.0, y, 3.0, 0.12, 0.1 * seed))
        (found,) = find_markings(raster(fine, noise=6.0))
        n = np.array([-np.sin(0.1 * seed), np.cos(0.1 * seed)])
        ratios.append(float((found.line[:, :2].mean(axis=0) - (8.0, y)) @ n) / found.sigma_m[0])
    assert np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_the_same_raster_gives_the_same_markings() -> None:
    fine = asphalt()
    for x in np.arange(3.0, 28.0, 3.0):
        paint(fine, bar(x, 6.0, 1.5, 0.15, 0.05))
    first, second = (find_markings(raster(fine)) for _ in range(2))
    assert [one.line.tobytes() for one in first] == [one.line.tobytes() for one in second]
