"""Bursts that come without a jump are left out with their feet; those that jump keep the fixes beside them."""

import dataclasses

import numpy as np
import pytest

from mapping.test_linear_beliefs import COUNT, all_believed, graph_of, ramp_and_back
from wayloom.mapping.burst_feet import SmoothEdge, foot, smooth_edges, within_reach
from wayloom.mapping.linear_beliefs import LinearBeliefs

T_S = np.arange(COUNT) * 0.1


def burst_between(first: int, end: int) -> np.ndarray:
    """(COUNT,) inlier: all but these."""
    return (np.arange(COUNT) < first) | (np.arange(COUNT) >= end)


def test_a_burst_that_jumps_has_no_smooth_edge() -> None:
    errors = np.zeros((COUNT, 3))
    errors[150:220] = [0.5, 0.0, 0.0]
    assert smooth_edges(T_S, burst_between(150, 220), errors) == []


def test_a_burst_that_grows_has_one_on_either_side_with_its_slope() -> None:
    inlier = burst_between(130, 270)
    comes, goes = smooth_edges(T_S, inlier, ramp_and_back(3.0) * ~inlier[:, None])
    assert (comes.fix, comes.side, goes.fix, goes.side) == (129, 1, 270, -1)
    assert comes.slope_m_s == pytest.approx([0.5, 0.0, 0.0], abs=0.1)
    assert goes.slope_m_s == pytest.approx([0.5, 0.0, 0.0], abs=0.1)


def test_fixes_that_leave_no_slope_behind_have_no_smooth_edge() -> None:
    assert smooth_edges(T_S, burst_between(150, 220), np.zeros((COUNT, 3))) == []


def test_no_foot_is_longer_than_its_burst_and_none_stands_at_an_end() -> None:
    reach = within_reach(T_S, burst_between(150, 170) & burst_between(0, 30))
    assert reach[133:187].all()
    assert reach.sum() < 64


def test_the_predicted_cost_of_errors_is_that_of_fixes_without_them() -> None:
    graph = graph_of(np.zeros((COUNT, 3)), (100,))
    state, believed = all_believed(graph).state, np.ones(len(graph.fixes), bool)
    state = graph.solve(np.ones(len(graph.price)), state, 30)
    error = np.where((graph.fixes.t_s < 8.0)[:, None], [0.02, -0.01, 0.03], 0.0)
    predicted = LinearBeliefs(graph, believed, np.zeros(0, bool), state).with_errors(error)
    before = graph.equations(np.ones(len(graph.price))).cost(state)
    graph.fixes = dataclasses.replace(graph.fixes, position_enu=graph.fixes.position_enu - error)
    after = graph.solve(np.ones(len(graph.price)), state, 30)
    assert predicted == pytest.approx(graph.equations(np.ones(len(graph.price))).cost(after) - before, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("noticed_s", [1.0, 2.0])
def test_the_foot_of_a_ramp_reaches_back_to_where_it_began(noticed_s: float) -> None:
    """Up over 6 s from 12 s on; noticed late, and not from 22 s on."""
    inlier = burst_between(round(10 * (12.0 + noticed_s)), 280)
    errors = ramp_and_back(3.0)
    graph = graph_of(errors, (int(np.argmin(inlier)), 280))
    believed = inlier[graph.witnesses.head]
    weight = inlier[graph.witnesses.first].astype(float)
    state = graph.solve(weight, all_believed(graph).state, 30)
    linear = LinearBeliefs(graph, believed, np.zeros(0, bool), state)
    edge = SmoothEdge(int(np.argmin(inlier)) - 1, 1, np.array([0.5, 0.0, 0.0]))
    found = foot(T_S, edge, linear, graph.witnesses.fixes.t_s)
    assert found[121 : int(np.argmin(inlier))].all()
    assert not found[:100].any()
    assert not found[280:].any()
