"""Markings and kerbs of one square of a grid: each once, long ones cut at the border."""

import numpy as np
import pytest

from wayloom.ground.markings.geometry import outline
from wayloom.ground.markings.squares import kerbs_of_square, markings_of_square, spans_inside
from wayloom.ground.markings.types import Kerb, Marking

EDGE_M, HALO_M = 64.0, 16.0


def marking(xy: list[tuple[float, float]], kind: str = "solid", width: float = 0.12) -> Marking:
    """A line whose height is a tenth of its x."""
    line = np.array([(x, y, 0.1 * x) for x, y in xy])
    ring = outline(line[:, :2], width)
    length = float(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1).sum())
    return Marking(kind, line, np.column_stack([ring, np.zeros(len(ring))]), width, length, np.full(3, 0.02), 0.9)


def kerb(xy: list[tuple[float, float]]) -> Kerb:
    """Its height is a hundredth of its x."""
    line = np.array([(x, y, 0.0) for x, y in xy])
    return Kerb(line, 0.01 * line[:, 0], np.full(2, 0.02), 0.9)


def squares(count: int = 4) -> list[np.ndarray]:
    return [EDGE_M * np.array([east, north], np.float64) for east in range(-1, count) for north in range(-1, count)]


def length(found: list[Marking]) -> float:
    return sum(float(np.linalg.norm(np.diff(one.line[:, :2], axis=0), axis=1).sum()) for one in found)


def test_a_short_line_is_whole_in_the_square_of_its_middle() -> None:
    dash = marking([(62.0, 10.0), (65.9, 10.0)], "dash")
    owners = [(low.tolist(), found) for low in squares() if (found := markings_of_square([dash], low, EDGE_M, HALO_M))]
    assert owners == [([0.0, 0.0], [dash])]


@pytest.mark.parametrize("x", [62.5, 63.999_999_9, 64.0, 64.000_000_1])
def test_rasters_that_differ_by_rounding_put_it_into_the_same_square(x: float) -> None:
    near = [marking([(x - 1.5 + noise, 10.0), (x + 1.5 + noise, 10.0)], "dash") for noise in (-1e-9, 0.0, 1e-9)]
    held = [[len(markings_of_square([one], low, EDGE_M, HALO_M)) for low in squares()] for one in near]
    assert held[0] == held[1] == held[2]
    assert sum(held[0]) == 1


def test_areas_are_never_cut() -> None:
    crossing = marking([(40.0, 10.0), (70.0, 10.0)], "zebra")
    assert [len(markings_of_square([crossing], low, EDGE_M, HALO_M)) for low in squares()].count(1) == 1


def test_a_long_line_is_cut_at_the_borders_and_its_parts_meet() -> None:
    line = marking([(10.0, 10.0), (100.0, 60.0), (150.0, 130.0)])
    found = [one for low in squares() for one in markings_of_square([line], low, EDGE_M, HALO_M)]
    assert length(found) == pytest.approx(line.length_m, abs=1e-9)
    assert sum(one.length_m for one in found) == pytest.approx(line.length_m, abs=1e-9)
    for one in found:
        np.testing.assert_allclose(one.line[:, 2], 0.1 * one.line[:, 0], atol=1e-9)
        middle = one.line[:, :2].mean(axis=0)
        low = np.floor(middle / EDGE_M) * EDGE_M
        assert (one.line[:, :2] >= low - 1e-9).all()
        assert (one.line[:, :2] <= low + EDGE_M + 1e-9).all()
        assert one.open == (bool((one.line[0] != line.line[0]).any()), bool((one.line[-1] != line.line[-1]).any()))
        assert np.abs(one.ring[:-1, :2] - middle).max() < EDGE_M


def test_a_line_of_just_the_halo_seen_cut_short_from_one_side_is_held_once() -> None:
    """Two rasters see it: one as a whole, the other as far as it reaches."""
    whole = marking([(63.0, 10.0), (83.0, 10.0)])
    seen_from_the_west = marking([(63.0, 10.0), (80.0, 10.0)])
    west = markings_of_square([seen_from_the_west], np.zeros(2), EDGE_M, HALO_M)
    east = markings_of_square([whole], np.array([64.0, 0.0]), EDGE_M, HALO_M)
    assert length(west) + length(east) == pytest.approx(20.0)


def test_kerbs_are_cut_with_their_heights() -> None:
    one = kerb([(x, 10.0) for x in np.arange(50.0, 80.25, 0.25)])
    found = [part for low in squares() for part in kerbs_of_square([one], low, EDGE_M, HALO_M)]
    assert [part.line[0, 0] for part in found] == [50.0, 64.0]
    assert sum(part.length_m for part in found) == pytest.approx(one.length_m)
    for part in found:
        np.testing.assert_allclose(part.height_m, 0.01 * part.line[:, 0], atol=1e-12)
    short = kerb([(63.0, 10.0), (66.0, 10.0)])
    assert [len(kerbs_of_square([short], low, EDGE_M, HALO_M)) for low in squares()].count(1) == 1


@pytest.mark.parametrize("seed", range(20))
def test_spans_in_a_box_are_those_of_many_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = np.round(rng.uniform(-3.0, 3.0, (6, 2)), 1 if seed % 2 else 6)  # rounded ones lie on the border and along the axes
    low, high = np.array([-1.0, -1.5]), np.array([1.0, 1.5])
    at = np.linspace(0.0, 5.0, 50_001)
    places = np.column_stack([np.interp(at, np.arange(6), column) for column in xy.T])
    inside = ((places > low) & (places < high)).all(axis=1)
    spans = [*spans_inside(xy, low, high)]
    held = np.zeros(len(at), bool)
    for first, last in spans:
        assert first < last
        held |= (at > first) & (at < last)
    assert (held != inside).sum() <= 2 * len(spans) + 2
