"""Votes of neighbouring loops for each other, and what their agreement tells of their sigmas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2 as chi_square

from wayloom.evaluation.made_graphs import city_drive, sphere, with_false_loops
from wayloom.geometry import se3
from wayloom.mapping.loop_votes import REACH, agreeing, cycle_chi2
from wayloom.mapping.pose_graph import optimise_pose_graph
from wayloom.mapping.pose_graph_equations import graph_equations
from wayloom.mapping.pose_graph_types import PoseGraph

LIMIT = float(chi_square.ppf(0.9999, 6))


def single_step_cycle(graph: PoseGraph, a: int, b: int) -> float:
    """Chi-square of the cycle of loops a and b whose ends are neighbours, by numeric differentiation."""
    i, j = int(graph.first[a]), int(graph.second[a])
    parts = [graph.T_first_second[k] for k in (a, j, b, i)]
    covariances = [np.linalg.inv(graph.information[k]) for k in (a, j, b, i)]

    def closed(steps: np.ndarray) -> np.ndarray:
        T = [se3.exp(steps[k]) @ parts[k] for k in range(4)]
        return np.asarray(se3.log(T[0] @ T[1] @ np.linalg.inv(T[2]) @ np.linalg.inv(T[3])))

    h = 1e-6
    total = np.zeros((6, 6))
    for k in range(4):
        J = np.zeros((6, 6))
        for c in range(6):
            step = np.zeros((4, 6))
            step[k, c] = h
            J[:, c] = (closed(step) - closed(-step)) / (2.0 * h)
        total += J @ covariances[k] @ J.T
    e = closed(np.zeros((4, 6)))
    return float(e @ np.linalg.solve(total, e))


@pytest.mark.parametrize("turned", [False, True])
def test_a_cycle_is_judged_by_the_covariances_of_its_four_parts(turned: bool) -> None:
    graph = sphere(3, 16, 0.01, 0.003, seed=1).graph
    a = int(np.flatnonzero(graph.is_loop)[4])
    rows = np.array([*range(47), a, a + 1])
    cut = replace(
        graph,
        first=graph.first[rows],
        second=graph.second[rows],
        T_first_second=graph.T_first_second[rows],
        information=graph.information[rows],
        is_loop=graph.is_loop[rows],
    )
    expected = single_step_cycle(cut, 47, 48)
    if turned:  # the same two witnesses, measured from their other ends
        Ad = se3.adjoint(se3.inverse(cut.T_first_second[47:]))
        omega = cut.information.copy()
        omega[47:] = np.linalg.inv(Ad @ np.linalg.inv(omega[47:]) @ np.swapaxes(Ad, 1, 2))
        T = cut.T_first_second.copy()
        T[47:] = se3.inverse(T[47:])
        first, second = cut.first.copy(), cut.second.copy()
        first[47:], second[47:] = cut.second[47:], cut.first[47:]
        cut = replace(cut, first=first, second=second, T_first_second=T, information=omega)
    chi2 = cycle_chi2(graph_equations(cut), np.array([47, 48]))
    # to first order in what the cycle fails to close by: hundredths of a radian
    assert chi2 == pytest.approx([expected, expected], rel=0.05)


def test_right_loops_agree_with_their_neighbours_and_false_ones_with_none() -> None:
    made = sphere(10, 20, 0.05, 0.01, seed=3)
    graph = with_false_loops(made.graph, 18, seed=3)
    equations = graph_equations(graph)
    agreed = agreeing(equations, graph.is_loop, LIMIT)
    right = np.arange(len(graph)) < len(made.graph)
    assert np.array_equal(agreed, graph.is_loop & right)


def test_a_loop_without_neighbours_has_no_vote() -> None:
    made = city_drive(600, 2, seed=1)
    loops = np.flatnonzero(made.graph.is_loop)
    ends = np.stack([made.graph.first[loops], made.graph.second[loops]], axis=1)
    assert np.abs(ends[0] - ends[1]).sum() > REACH  # steps along the chain
    assert np.isinf(cycle_chi2(graph_equations(made.graph), loops)).all()


def test_false_loops_within_sigmas_a_hundred_times_too_large_are_left_out() -> None:
    made = sphere(10, 20, 0.02, 0.002, seed=5)
    unsure = replace(made.graph, information=1e-4 * made.graph.information)
    false = with_false_loops(unsure, 18, seed=5)
    clean, solution = optimise_pose_graph(unsure), optimise_pose_graph(false)
    assert np.array_equal(solution.weight > 0.0, np.arange(len(false)) < len(unsure))
    np.testing.assert_allclose(solution.T_world_node, clean.T_world_node, atol=1e-6)
