"""The search for loops on made drives with exact truth."""

import numpy as np
import pytest

from loops.made_drives import made_places, there, there_and_back
from registration.made_streets import made_street
from wayloom.geometry import se3
from wayloom.loops.search import find_loops
from wayloom.loops.types import LoopClosures


def errors(loops: LoopClosures, T_street_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Metres, and chi-square over its 6 degrees of freedom."""
    metres, chi2 = [], []
    for i, j, T, covariance in zip(loops.first, loops.second, loops.T_first_second, loops.covariance, strict=True):
        truth = se3.inverse(T_street_cam[i]) @ T_street_cam[j]
        xi = se3.log(truth @ se3.inverse(T))
        metres.append(np.linalg.norm(T[:3, 3] - truth[:3, 3]))
        chi2.append(xi @ np.linalg.solve(covariance, xi) / 6.0)
    return np.array(metres), np.array(chi2)


@pytest.fixture(scope="module")
def way() -> np.ndarray:
    return there_and_back(40.0, 150.0)


@pytest.fixture(scope="module")
def loops(way: np.ndarray) -> LoopClosures:
    return find_loops(made_places(made_street(4), way, 1))


def test_a_street_driven_back_is_closed(way: np.ndarray, loops: LoopClosures) -> None:
    metres, chi2 = errors(loops, way)
    assert len(loops) >= 8
    assert (loops.first < loops.second).all()
    assert metres.max() < 0.5
    assert chi2.max() < 22.5 / 6.0  # chi-square, 6 degrees of freedom, 99.9 %


def test_the_way_back_is_closed_for_most_of_its_length(way: np.ndarray, loops: LoopClosures) -> None:
    """Of places that lie 20 m and more within the street, and 40 m of road and more behind their first time."""
    anchors = [j for j in range(len(way) // 2, len(way), 2) if 60.0 < way[j, 1, 3] < 130.0]
    closed = [j for j in anchors if np.abs(loops.second - j).min() <= 2]
    assert len(closed) >= 0.8 * len(anchors)


def test_the_report_says_what_was_tried_and_refused(loops: LoopClosures) -> None:
    assert loops.report["accepted"] == len(loops)
    assert loops.report["tried"] >= loops.report["fitting"] >= loops.report["accepted"]


def test_a_drive_that_passes_no_place_twice_is_not_compared_at_all() -> None:
    loops = find_loops(made_places(made_street(4), there(40.0, 170.0), 1))
    assert len(loops) == 0
    assert loops.report["tried"] == 0


def test_blocks_that_look_alike_give_no_false_closure() -> None:
    way = there_and_back(40.0, 150.0)
    loops = find_loops(made_places(made_street(5, alike=True), way, 2))
    metres, _ = errors(loops, way)
    assert (metres < 1.0).all()


def test_progress_is_shown_and_never_falls() -> None:
    shares: list[float] = []
    find_loops(made_places(made_street(4), there(40.0, 120.0), 1), progress=lambda share, _: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
