"""Votes of neighbouring loops for each other, and what their agreement tells of their sigmas."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2 as chi_square

from wayloom.evaluation.made_graphs import city_drive, measured_graph, sphere, with_false_loops
from wayloom.geometry import se3
from wayloom.mapping.descent import descend
from wayloom.mapping.loop_votes import REACH, agreeing, cycle_chi2, plausible
from wayloom.mapping.pose_graph import optimise_pose_graph
from wayloom.mapping.pose_graph_equations import GraphEquations, graph_equations
from wayloom.mapping.pose_graph_types import PoseGraph

FloatArray = NDArray[np.float64]
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


@pytest.mark.parametrize("planar", [False, True])
def test_every_loop_within_its_limit_by_the_exact_covariance_is_plausible_and_false_ones_are_not(planar: bool) -> None:
    made = sphere(4, 12, 0.02, 0.004, seed=6)
    steps, T_true = made.graph, made.T_world_true
    if planar:
        turn = np.arange(48) * (2.0 * np.pi / 24.0)
        xi = np.zeros((48, 6))
        xi[:, 5] = turn
        T_true = se3.exp(xi)
        T_true[:, :2, 3] = 20.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        pairs = np.stack([np.arange(24), np.arange(24, 48)], axis=1)
        steps = replace(measured_graph(T_true, pairs, 0.02, 0.004, seed=6).graph, planar=True)
    graph = with_false_loops(steps, 6, seed=6)
    equations = graph_equations(graph)
    kept = ~graph.is_loop
    kept[len(steps) - 3 : len(steps)] = True
    part = equations.of(kept)
    state = descend(part, part.state(T_true), np.ones(int(kept.sum())), 50, 1e-9).state
    diagonal, blocks, _ = part.normal(state, part.errors(state), np.ones(int(kept.sum())))
    exact = exact_mahalanobis2(equations, part, state, dense(part, diagonal, blocks))
    limit = float(np.median(exact[: len(steps)][graph.is_loop[: len(steps)]]))
    out = plausible(equations, part, state, limit)
    assert out[exact <= limit].all()
    assert not out[len(steps) :].any()


def dense(part: GraphEquations, diagonal: FloatArray, blocks: FloatArray) -> FloatArray:
    """The normal matrix, of blocks d x d of N + 1 nodes."""
    d, n = part.block, len(part.held)
    H = np.zeros((n, d, n, d))
    H[np.arange(n), :, np.arange(n)] = diagonal
    for e, slot in enumerate(part.slot.tolist()):
        if slot < part.pairs:
            i, j = (part.first[e], part.second[e]) if slot >= 0 else (part.second[e], part.first[e])
            block = blocks[slot if slot >= 0 else ~slot]
            H[i, :, j], H[j, :, i] = block, block.T
    return H.reshape(n * d, n * d)


def exact_mahalanobis2(equations: GraphEquations, part: GraphEquations, state: FloatArray, H: FloatArray) -> FloatArray:
    """(E,) with the joint covariance of both poses."""
    d, h = equations.block, 1e-6
    covariance = np.linalg.inv(H)
    out = []
    for e in range(len(equations.first)):
        J = np.zeros((d, len(H)))
        for node in (equations.first[e], equations.second[e]):
            for c in range(d):
                step = np.zeros((len(equations.held), d))
                step[node, c] = h
                J[:, node * d + c] = (equations.errors(equations.moved(state, step)) - equations.errors(state))[e] / h
        held = np.repeat(equations.held, d)
        J[:, held] = 0.0
        error = equations.errors(state)[e]
        out.append(error @ np.linalg.solve(np.linalg.inv(equations.information[e]) + J @ covariance @ J.T, error))
    return np.array(out)
