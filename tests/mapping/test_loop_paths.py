"""Shortest ways between the ends of loops, and the loops that they close."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.stats import chi2 as chi_square

from wayloom.evaluation.made_graphs import sphere, with_false_groups
from wayloom.geometry import se3
from wayloom.mapping.kernels.shortest_paths import fill_paths
from wayloom.mapping.loop_paths import closing
from wayloom.mapping.loop_votes import agreeing
from wayloom.mapping.pose_graph_equations import graph_equations

LIMIT = float(chi_square.ppf(0.9999, 6))


@pytest.mark.kernels
def test_ways_are_those_of_scipy_and_add_up_their_steps() -> None:
    rng = np.random.default_rng(1)
    nodes, steps = 12, 30
    tail, head = rng.integers(0, nodes, (2, steps))
    length = rng.uniform(0.1, 1.0, steps)
    T_step = se3.exp(rng.normal(size=(steps, 6)))
    half = rng.normal(size=(steps, 6, 6))
    covariance = half @ np.swapaxes(half, 1, 2)
    order = np.argsort(tail, kind="stable")
    start = np.searchsorted(tail[order], np.arange(nodes + 1))
    source, target = np.full(nodes, 3), np.arange(nodes)
    reached, T, total = np.zeros(nodes, np.bool_), np.zeros((nodes, 4, 4)), np.zeros((nodes, 6, 6))
    fill_paths(source, target, start, head[order], order, length, T_step, covariance, 1.5, reached, T, total)
    best = np.full((nodes, nodes), np.inf)
    np.minimum.at(best, (tail, head), length)
    row, column = np.nonzero(np.isfinite(best))
    far, came = dijkstra(coo_matrix((best[row, column], (row, column)), (nodes, nodes)), indices=3, return_predecessors=True)
    assert np.array_equal(reached, far <= 1.5)
    assert 3 < reached.sum() < nodes
    for node in np.flatnonzero(reached):
        T_way, C_way = np.eye(4), np.zeros((6, 6))
        way = [node]
        while way[0] != 3:
            way.insert(0, came[way[0]])
        for i, j in pairwise(way):
            (s,) = np.flatnonzero((tail == i) & (head == j) & (length == best[i, j]))
            Ad = se3.adjoint(T_way)
            T_way, C_way = T_way @ T_step[s], C_way + Ad @ covariance[s] @ Ad.T
        np.testing.assert_allclose(T[node], T_way, atol=1e-12)
        np.testing.assert_allclose(total[node], C_way, rtol=1e-9, atol=1e-9)


def test_groups_of_false_loops_have_votes_but_no_way_closes_them() -> None:
    made = sphere(10, 20, 0.02, 0.005, seed=3)
    graph = with_false_groups(made.graph, 24, 6, seed=3)
    equations, right = graph_equations(graph), np.arange(len(graph)) < len(made.graph)
    agreed = agreeing(equations, graph.is_loop, LIMIT)
    assert agreed[~right].mean() > 0.9
    assert np.array_equal(closing(equations, graph.is_loop, agreed, LIMIT), graph.is_loop & right)


def test_odometry_told_backwards_closes_the_same_loops() -> None:
    made = sphere(10, 20, 0.02, 0.005, seed=3)
    graph = with_false_groups(made.graph, 24, 6, seed=3)
    turned = ~graph.is_loop & (graph.first % 3 == 0)
    back = se3.inverse(graph.T_first_second)
    Ad = se3.adjoint(graph.T_first_second)
    other = replace(
        graph,
        first=np.where(turned, graph.second, graph.first),
        second=np.where(turned, graph.first, graph.second),
        T_first_second=np.where(turned[:, None, None], back, graph.T_first_second),
        information=np.where(turned[:, None, None], np.swapaxes(Ad, 1, 2) @ graph.information @ Ad, graph.information),
    )
    told = [graph_equations(g) for g in (graph, other)]
    votes = [agreeing(equations, graph.is_loop, LIMIT) for equations in told]
    assert np.array_equal(*votes)
    assert np.array_equal(*(closing(e, graph.is_loop, vote, LIMIT) for e, vote in zip(told, votes, strict=True)))


def test_loops_far_better_than_their_sigmas_refuse_groups_that_these_would_let_in() -> None:
    made = sphere(10, 20, 0.02, 0.005, seed=3)
    graph = with_false_groups(made.graph, 24, 6, seed=3)
    loose = replace(graph, information=graph.information / 30.0**2)
    right = np.arange(len(graph)) < len(made.graph)
    kept = closing(graph_equations(loose), graph.is_loop, graph.is_loop, LIMIT)
    assert not kept[~right].any()
    assert kept[right & graph.is_loop].mean() > 0.8


def test_without_candidates_nothing_closes() -> None:
    graph = sphere(4, 12, 0.02, 0.005, seed=3).graph
    assert not closing(graph_equations(graph), graph.is_loop, np.zeros(len(graph), np.bool_), LIMIT).any()
