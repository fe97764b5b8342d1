"""Wild fixes are told from bursts, jumps for good and receivers that scatter."""

import dataclasses

import numpy as np
import pytest

from wayloom.mapping.drive_types import AntennaFixes
from wayloom.mapping.wild_fixes import wild_fixes

COUNT = 200


def fixes_along_a_road(sigma_m: float, stated_m: float, seed: int = 0) -> tuple[AntennaFixes, np.ndarray]:
    """Ten fixes a second at 15 m/s, and the nodes (one a fix) where they were received."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, 0, 3] = 1.5 * np.arange(COUNT)
    zeros, ones = np.zeros((COUNT, 3)), np.tile(np.eye(3), (COUNT, 1, 1))
    fixes = AntennaFixes(
        t_s=0.1 * np.arange(COUNT),
        node=np.arange(COUNT),
        p_node_gnss=zeros,
        late_s=zeros[:, 0],
        v_node_gnss=zeros,
        R_node_cam=ones,
        position_enu=T[:, :3, 3] + rng.normal(size=(COUNT, 3)) * sigma_m,
        covariance=stated_m**2 * ones,
        kind=np.ones(COUNT, np.uint8),
        white_share=np.full(COUNT, 0.5),
    )
    return fixes, T


def moved(fixes: AntennaFixes, rows: np.ndarray, by_m: np.ndarray) -> AntennaFixes:
    position = fixes.position_enu.copy()
    position[rows] += by_m
    return dataclasses.replace(fixes, position_enu=position)


@pytest.mark.parametrize("seed", range(5))
def test_a_fifth_thrown_anywhere_is_found_but_for_few_that_stand_together(seed: int) -> None:
    fixes, T = fixes_along_a_road(0.02, 0.02, seed)
    rng = np.random.default_rng(seed)
    rows = rng.choice(COUNT, COUNT // 5, replace=False)
    wild = wild_fixes(moved(fixes, rows, rng.normal(size=(len(rows), 3)) * 50.0), T)
    assert wild[rows].mean() >= 0.95
    assert np.delete(wild, rows).mean() < 0.02


def test_a_burst_is_none_of_them() -> None:
    fixes, T = fixes_along_a_road(0.02, 0.02)
    assert not wild_fixes(moved(fixes, np.arange(60, 100), np.array([30.0, 40.0, 0.0])), T).any()


def test_fixes_that_change_place_for_good_are_none_of_them() -> None:
    fixes, T = fixes_along_a_road(0.02, 0.02)
    assert not wild_fixes(moved(fixes, np.arange(120, COUNT), np.array([1.5, 0.0, 0.0])), T).any()


def test_a_receiver_that_understates_its_scatter_has_none() -> None:
    fixes, T = fixes_along_a_road(1.6, 0.02)
    assert wild_fixes(fixes, T).mean() < 0.02


def test_where_most_are_wild_none_is_left_out() -> None:
    fixes, T = fixes_along_a_road(0.02, 0.02)
    rng = np.random.default_rng(1)
    rows = rng.choice(COUNT, int(0.45 * COUNT), replace=False)
    assert not wild_fixes(moved(fixes, rows, rng.normal(size=(len(rows), 3)) * 50.0), T).any()


def test_a_handful_of_fixes_is_not_judged() -> None:
    fixes, T = fixes_along_a_road(0.02, 0.02)
    few = moved(fixes, np.array([3]), np.array([50.0, 0.0, 0.0])).take(np.arange(8))
    assert not wild_fixes(few, T).any()
