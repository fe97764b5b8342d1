from itertools import permutations

import numpy as np
import pytest

from wayloom.ground.markings.geometry import outline
from wayloom.ground.markings.merging import merged_kerbs, merged_markings
from wayloom.ground.markings.types import Kerb, Marking


def line(x0: float, x1: float, y: float = 0.0, kind: str = "dash", opened: tuple[bool, bool] = (False, False)) -> Marking:
    xy = np.array([(x0, y), (x1, y)])
    ring = outline(xy, 0.12)
    return Marking(
        kind,
        np.column_stack([xy, [0, 0]]),
        np.column_stack([ring, np.zeros(len(ring))]),
        0.12,
        x1 - x0,
        np.full(3, 0.01),
        0.9,
        opened,
    )


def kerb(x0: float, x1: float, y: float) -> Kerb:
    x = np.arange(x0, x1 + 0.01, 0.5)
    return Kerb(np.column_stack([x, np.full(len(x), y), np.zeros(len(x))]), np.full(len(x), 0.12), np.full(2, 0.02), 0.9)


def test_a_dash_of_two_sheets_is_one_and_its_neighbours_stay() -> None:
    found = merged_markings([line(0, 3), line(0.02, 2.98, 0.03), line(6, 9), line(0, 3, 0.9)], 8.0)
    assert len(found) == 3


def test_a_line_that_two_sheets_cut_becomes_one_solid_line() -> None:
    (found,) = merged_markings([line(0, 7, opened=(False, True)), line(5, 12, 0.02, opened=(True, False))], 8.0)
    assert found.kind == "solid"
    assert found.length_m == pytest.approx(12.0, abs=0.1)
    assert found.open == (False, False)


def test_the_order_does_not_matter() -> None:
    parts = [line(0, 7), line(5, 12, 0.02), line(14, 17), line(13.9, 17.1, 0.05)]
    results = {tuple(sorted(one.line.tobytes() for one in merged_markings(list(order), 8.0))) for order in permutations(parts)}
    assert len(results) == 1


def test_a_line_that_bridges_two_others_makes_one_of_the_three() -> None:
    for order in permutations([line(0, 7), line(9, 16), line(6, 10)]):
        (whole,) = merged_markings(list(order), 8.0)
        assert (whole.kind, round(whole.length_m, 3)) == ("solid", 16.0)


def test_a_line_across_another_stays() -> None:
    across = np.array([(2.0, -3.0, 0.0), (2.0, 3.0, 0.0)])
    ring = outline(across[:, :2], 0.12)
    other = Marking("dash", across, np.column_stack([ring, np.zeros(len(ring))]), 0.12, 6.0, np.full(3, 0.01), 0.9)
    assert len(merged_markings([line(0, 4), other], 8.0)) == 2


def test_kerbs_keep_what_no_longer_kerb_covers() -> None:
    found = merged_kerbs([kerb(0, 20, 0.0), kerb(10, 26, 0.2), kerb(0, 8, 12.0)], 1.5)
    assert sorted(round(one.length_m, 1) for one in found) == [5.5, 8.0, 20.0]
