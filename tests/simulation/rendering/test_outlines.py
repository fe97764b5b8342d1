"""Outlines as people draw them: things without holes."""

import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.rendering.outlines import without_holes
from wayloom.simulation.rendering.renderer import Truth

ROAD, CAR, BICYCLE, RIDER, SKY = (CLASS_ID[name] for name in ("road", "car", "bicycle", "rider", "sky"))
SHAPE = (40, 60)


def ground() -> Truth:
    """A road 20 m away under the sky."""
    depth, class_id = np.full(SHAPE, 20.0, np.float32), np.full(SHAPE, ROAD, np.uint8)
    depth[:15], class_id[:15] = 0.0, SKY
    return Truth(depth, class_id, np.zeros(SHAPE, np.uint16))


def render(truth: Truth, where: np.ndarray, class_id: int, number: int, depth: float) -> None:
    """One more thing, before all that is there."""
    truth.depth[where], truth.class_id[where], truth.instance[where] = depth, class_id, number


def ring(x: float, y: float, outer: float, inner: float) -> np.ndarray:
    """Pixels between two circles."""
    rows, columns = np.indices(SHAPE)
    r = np.hypot(columns - x, rows - y)
    return np.asarray((r < outer) & (r >= inner))


def naive(truth: Truth, number: int) -> np.ndarray:
    """Pixels that a thing shuts in, by flooding from the border."""
    free = truth.instance != number
    outside = np.zeros(SHAPE, bool)
    outside[[0, -1]], outside[:, [0, -1]] = free[[0, -1]], free[:, [0, -1]]
    while True:
        grown = outside.copy()
        grown[1:] |= outside[:-1]
        grown[:-1] |= outside[1:]
        grown[:, 1:] |= outside[:, :-1]
        grown[:, :-1] |= outside[:, 1:]
        grown &= free
        if (grown == outside).all():
            return np.asarray(free & ~outside)
        outside = grown


def test_what_is_seen_through_a_wheel_counts_as_the_bicycle() -> None:
    truth = ground()
    render(truth, ring(25, 20, 10, 7), BICYCLE, 5, 8.0)
    out = without_holes(truth)
    hole = naive(truth, 5)
    assert hole.sum() > 100
    assert (out[hole] == BICYCLE).all()
    assert (out[~hole] == truth.class_id[~hole]).all()


def test_what_stands_before_a_thing_is_no_hole_in_it() -> None:
    truth = ground()
    render(truth, ring(25, 20, 12, 0), CAR, 5, 8.0)
    render(truth, ring(25, 20, 4, 0), RIDER, 6, 5.0)
    assert (without_holes(truth) == truth.class_id).all()


def test_a_rim_broken_by_a_pixel_is_closed_and_an_open_bend_is_not() -> None:
    truth = ground()
    wheel = ring(20, 20, 10, 7)
    wheel[20, :14] = False
    render(truth, wheel, BICYCLE, 5, 8.0)
    bend = ring(45, 20, 10, 7)
    bend[:20] = False
    render(truth, bend, BICYCLE, 6, 8.0)
    out = without_holes(truth)
    assert out[20, 20] == BICYCLE
    assert out[20, 45] == ROAD


def test_a_hole_has_the_class_of_the_part_around_it() -> None:
    truth = ground()
    render(truth, ring(20, 20, 10, 7), BICYCLE, 5, 8.0)
    render(truth, ring(38, 20, 9, 6), RIDER, 5, 8.0)
    out = without_holes(truth)
    assert (out[20, 20], out[20, 38]) == (BICYCLE, RIDER)


@pytest.mark.parametrize("nearer", [5, 6])
def test_of_two_things_behind_each_other_the_nearer_has_the_hole(nearer: int) -> None:
    truth = ground()
    depth = {5: 9.0, 6: 9.0, nearer: 7.0}
    for number in sorted(depth, key=lambda n: -depth[n]):
        outer, inner, cls = (14, 10, CAR) if number != nearer else (9, 6, BICYCLE)
        render(truth, ring(30, 20, outer, inner), cls, number, depth[number])
    assert without_holes(truth)[20, 30] == BICYCLE
