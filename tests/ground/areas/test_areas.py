"""Areas of made rasters: exact tilings, whatever the classes look like, that join over the edges of squares."""

import itertools

import numpy as np
import pytest
from scipy import ndimage
from shapely.geometry import Point, Polygon, box
from shapely.ops import unary_union

from wayloom.ground.areas.arcs import arcs_of
from wayloom.ground.areas.classes import area_classes, least_cells, patches, reach_m, vote_shares, without_cut_off
from wayloom.ground.areas.faces import faces_of
from wayloom.ground.areas.find import PARTS, Area, find_areas
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.areas.simplification import entangled, simplified
from wayloom.ground.sheet import CELL_M

SETTINGS = AreaSettings()
HALO, EDGE = 140, 200


def blotches(size: int, seed: int) -> np.ndarray:
    """(size, size, 3) votes for three classes in blotches of a metre and more, noisy, with unseen places."""
    rng = np.random.default_rng(seed)
    fields = np.stack([9.0 * ndimage.gaussian_filter(rng.normal(size=(size, size)), 9.0) for _ in range(3)], axis=2)
    votes = np.maximum(150.0 * (fields - fields.min()) + rng.normal(0.0, 12.0, fields.shape), 0.0).astype(np.uint32)
    votes[ndimage.gaussian_filter(rng.normal(size=(size, size)), 12.0) > 0.025] = 0
    return votes


def shape(area: Area) -> Polygon:
    """In cells, exactly."""
    return Polygon(*(lambda rings: (rings[0], rings[1:]))([np.rint(ring / CELL_M) for ring in area.rings]))


def of_square(votes: np.ndarray, column: int, row: int, settings: AreaSettings = SETTINGS) -> list[Area]:
    first = np.array([column, row]) - HALO
    part = votes[row - HALO : row + EDGE + HALO, column - HALO : column + EDGE + HALO]
    return find_areas(part, first, HALO, settings)


def test_the_halo_of_the_tests_is_wide_enough() -> None:
    assert reach_m(SETTINGS) <= HALO * CELL_M


@pytest.mark.parametrize("seed", [1, 2])
def test_areas_of_squares_beside_each_other_have_no_gap_and_nothing_in_common(seed: int) -> None:
    votes = blotches(2 * EDGE + 2 * HALO, seed)
    found = {(i, j): of_square(votes, HALO + i * EDGE, HALO + j * EDGE) for i, j in itertools.product((0, 1), repeat=2)}
    shapes = {key: [shape(one) for one in areas] for key, areas in found.items()}
    everything = [*itertools.chain(*shapes.values())]
    assert len(everything) > 20
    assert all(one.is_valid for one in everything)
    assert unary_union(everything).area == sum(one.area for one in everything)
    for (i, j), own in shapes.items():
        square = box(*(HALO + EDGE * np.array([i, j, i + 1, j + 1])))
        assert all(square.covers(one) for one in own)
    for (a, b), axis in ((((0, 0), (1, 0)), 0), (((0, 0), (0, 1)), 1)):
        at = HALO + EDGE
        west, east = ({p for one in shapes[key] for p in points_on(one, axis, at)} for key in (a, b))
        nodes = west | east
        for key in (a, b):
            for one in shapes[key]:
                on_edge = [p for p in nodes if one.boundary.distance(Point(p)) == 0.0]
                assert {*on_edge} <= {*points_on(one, axis, at)}  # what is a corner of one is one of its neighbour's, too
    smallest = min(one.area for one in everything)
    assert smallest * CELL_M**2 > 0.5 * SETTINGS.least_m2 / PARTS


def points_on(one: Polygon, axis: int, at: float) -> list[tuple[float, float]]:
    rings = [one.exterior, *one.interiors]
    return [p for ring in rings for p in ring.coords if p[axis] == at]


def test_outlines_leave_the_cells_by_no_more_than_the_tolerance() -> None:
    votes = blotches(EDGE + 2 * HALO, 5)
    fine, coarse = (of_square(votes, HALO, HALO, SETTINGS.model_copy(update={"tolerance_m": t})) for t in (0.0, 0.15))
    assert sum(len(ring) for one in coarse for ring in one.rings) < 0.6 * sum(len(ring) for one in fine for ring in one.rings)
    exact = unary_union([shape(one).boundary for one in fine])
    for one in coarse:
        for ring in one.rings:
            for p in np.rint(ring / CELL_M):
                assert exact.distance(Point(p)) == 0.0
        line = shape(one).exterior
        off = [exact.distance(line.interpolate(at)) for at in np.arange(0.0, line.length, 0.5)]
        assert max(off) <= 1.5


def test_small_patches_and_holes_are_left_to_what_surrounds_them() -> None:
    votes = np.zeros((EDGE + 2 * HALO,) * 2 + (3,), np.uint32)
    votes[..., 0] = 90
    middle = HALO + EDGE // 2
    votes[middle : middle + 7, middle : middle + 7] = (0, 90, 0)
    votes[middle + 20 : middle + 27, middle : middle + 7] = 0
    votes[middle - 40 : middle - 20, middle : middle + 20] = (0, 0, 90)
    road, lawn = of_square(votes, HALO, HALO)
    assert (road.column, len(road.rings), lawn.column, len(lawn.rings)) == (0, 2, 2, 1)
    assert lawn.area_m2 == pytest.approx(4.0, abs=0.1)
    assert road.area_m2 == pytest.approx(400.0 - lawn.area_m2)
    assert lawn.confidence == pytest.approx(1.0)
    assert 0.99 < road.confidence < 1.0


def test_cells_agree_on_their_classes_whatever_raster_they_are_on() -> None:
    votes = blotches(2 * HALO + 260, 3)
    whole, part = (area_classes(vote_shares(one), SETTINGS) for one in (votes, votes[60:, 40:]))
    np.testing.assert_array_equal(whole[60 + HALO : -HALO, 40 + HALO : -HALO], part[HALO:-HALO, HALO:-HALO])


def test_no_patch_is_smaller_than_the_smallest() -> None:
    classes = area_classes(vote_shares(blotches(500, 4)), SETTINGS)
    numbers, count = patches(classes)
    assert np.bincount(numbers.ravel(), minlength=count + 1)[1:].min() >= least_cells(SETTINGS)


def test_a_chessboard_is_a_clean_tiling() -> None:
    """Every inner point is a node at which four patches touch, two of one class."""
    classes = (np.indices((12, 12)).sum(axis=0) % 2 + 1).astype(np.uint8)
    numbers, count = patches(classes[1:-1, 1:-1])
    faces = faces_of(arcs_of(numbers, classes), 1.5)
    assert count == 100
    shapes = [Polygon(rings[0], rings[1:]) for rings in faces.values()]
    assert sum(one.area for one in shapes) == unary_union(shapes).area == 100.0


def test_a_ring_that_closes_at_a_corner_has_a_hole_that_touches_its_outline() -> None:
    classes = np.ones((10, 10), np.uint8)
    classes[3:7, 3:7] = 2
    classes[4:6, 4:6] = 1
    classes[3, 3] = 1
    numbers, _ = patches(classes[1:-1, 1:-1])
    faces = faces_of(arcs_of(numbers, classes), 0.0)
    shapes = [Polygon(rings[0], rings[1:]) for rings in faces.values()]
    assert sorted(one.area for one in shapes) == [4.0, 11.0, 49.0]
    assert all(one.is_valid for one in shapes)


def test_noise_of_single_cells_is_tiled_exactly() -> None:
    rng = np.random.default_rng(8)
    classes = rng.integers(0, 4, (42, 42)).astype(np.uint8)
    numbers, count = patches(classes[1:-1, 1:-1])
    faces = faces_of(arcs_of(numbers, classes), 1.5)
    shapes = [Polygon(rings[0], rings[1:]) for rings in faces.values()]
    assert all(one.is_valid for one in shapes)
    assert sum(one.area for one in shapes) == unary_union(shapes).area == 1600.0
    assert len(faces) <= count


def test_lines_are_simplified_to_the_tolerance_and_keep_their_ends() -> None:
    stairs = np.array([(k // 2, (k + 1) // 2) for k in range(41)])
    np.testing.assert_array_equal(simplified(stairs, 1.0), stairs[[0, -1]])
    np.testing.assert_array_equal(simplified(stairs, 0.0), stairs)
    loop = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)])
    np.testing.assert_array_equal(simplified(loop, 0.5), loop)


def test_lines_that_meet_elsewhere_than_at_ends_are_found() -> None:
    def line(*points: tuple[int, int]) -> np.ndarray:
        return np.array(points)

    assert entangled([line((0, 0), (4, 4)), line((0, 4), (4, 0))]) == {0, 1}
    assert entangled([line((0, 0), (4, 0)), line((2, 0), (2, 3))]) == {0, 1}
    assert entangled([line((0, 0), (4, 0)), line((0, 0), (6, 0))]) == {0, 1}
    assert entangled([line((0, 0), (4, 0)), line((4, 0), (6, 0)), line((4, 0), (4, 3))]) == set()
    assert entangled([line((0, 0), (4, 0)), line((0, 0), (4, 0))]) == set()
    assert entangled([line((0, 0), (2, 2), (4, 0)), line((0, 4), (2, 2), (4, 4))]) == {0, 1}
    assert entangled([line((0, 0), (2, 2), (0, 0))]) == {0}


def test_what_an_edge_cuts_off_takes_the_class_that_it_borders_on_most_whole() -> None:
    classes = np.ones((12, 12), np.uint8)
    classes[:, 7:] = 2
    classes[0, 5:9] = 3
    classes[0, 6:8] = 0
    cleaned = without_cut_off(classes, 3)
    assert cleaned[0].tolist() == [1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2]
    np.testing.assert_array_equal(cleaned[1:], classes[1:])
    chessboard = (np.indices((20, 20)).sum(axis=0) % 2).astype(np.uint8)
    assert not without_cut_off(chessboard, 2).any()
