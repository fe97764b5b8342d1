"""Predicted costs of other beliefs against those that are solved for, and the score test of errors without a jump."""

import dataclasses

import numpy as np
import pytest

from mapping.test_drive_graph import NOISE, exact_fixes, straight
from wayloom.geometry import se3
from wayloom.mapping import linear_beliefs
from wayloom.mapping.belief_doubts import FOUND, HINTED, examine, second_moments, spread_doubts
from wayloom.mapping.bias_courses import _near_in_time, bias_courses
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_witnesses import witnesses_of
from wayloom.mapping.linear_beliefs import LinearBeliefs
from wayloom.mapping.stretch_choice import Choice, choose, cost
from wayloom.mapping.witness_graph import WitnessGraph

COUNT, SIGMA_M = 400, 0.03


def graph_of(errors_m: np.ndarray, jumps: tuple[int, ...] = (), seed: int = 0) -> WitnessGraph:
    """A straight drive of 40 s with white noise and errors (COUNT, 3) m of its fixes, cut at these rows."""
    chain = straight(COUNT)
    fixes = exact_fixes(chain, SIGMA_M)
    noise = np.random.default_rng(seed).normal(size=(COUNT, 3)) * SIGMA_M
    fixes = dataclasses.replace(fixes, position_enu=fixes.position_enu + noise + errors_m, white_share=np.full(COUNT, 0.95))
    jump = np.isin(np.arange(COUNT), (0, *jumps))
    return WitnessGraph(chain, witnesses_of(fixes, jump, chain.T_world_node, NOISE), NOISE, Evidence())


def all_believed(graph: WitnessGraph) -> Choice:
    believed = np.ones(len(graph.price), bool)
    state = graph.solve(np.ones(len(graph.price)), graph.equations(np.ones(len(graph.price))).first_state(
        graph.coarse.T_world_node), 20)  # fmt: skip
    return Choice(believed, state, cost(graph, believed, state))


def ramp_and_back(size_m: float) -> np.ndarray:
    """(COUNT, 3) m: to size_m east and back, from 12 to 28 s."""
    t_s = np.arange(COUNT) * 0.1
    return np.outer(np.clip(np.minimum(t_s - 12.0, 28.0 - t_s) / 6.0, 0.0, 1.0) * size_m, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("believed_first", [True, False])
def test_the_predicted_cost_and_move_of_a_turned_stretch_are_those_of_the_solution(believed_first):
    errors = np.zeros((COUNT, 3))
    errors[150:220] = [0.4, 0.0, 0.2]
    graph = graph_of(errors, (150, 220))
    before = all_believed(graph).believed
    turned = np.unique(graph.witnesses.stretch[(graph.witnesses.head >= 150) & (graph.witnesses.tail < 220)])
    after = before.copy()
    after[turned] = False
    if not believed_first:
        before, after = after, before
    state = all_believed(graph).state
    state = graph.solve(np.where(before, 1.0, 0.0), state, 30)
    other = graph.solve(np.where(after, 1.0, 0.0), state, 30)
    linear = LinearBeliefs(graph, before[graph.witnesses.stretch], np.zeros(0, bool), state)
    rows = np.flatnonzero((before != after)[graph.witnesses.stretch])
    change, pull = linear.turned(rows)
    priced = 0.5 * float(graph.importance @ (np.where(after, 0.0, graph.price) - np.where(before, 0.0, graph.price)))
    assert change + priced == pytest.approx(cost(graph, after, other) - cost(graph, before, state), rel=1e-3)
    moved = se3.exp(linear.moved(rows, pull)) @ state.T_enu_node
    assert np.allclose(moved[:, :3, 3], other.T_enu_node[:, :3, 3], atol=0.01)  # the roll, free to degrees, is not linear


def test_noise_alone_shows_no_course_of_errors():
    for seed in range(5):
        graph = graph_of(np.zeros((COUNT, 3)), seed=seed)
        choice = all_believed(graph)
        linear = LinearBeliefs(graph, np.ones(len(graph.fixes), bool), np.zeros(0, bool), choice.state)
        assert max(course.chi2 for course in bias_courses(graph, linear)) < HINTED


def test_a_ramp_without_a_jump_is_found_with_its_size():
    graph = graph_of(ramp_and_back(1.0))
    choice = all_believed(graph)
    linear = LinearBeliefs(graph, np.ones(len(graph.fixes), bool), np.zeros(0, bool), choice.state)
    best = max(bias_courses(graph, linear), key=lambda course: course.chi2)
    assert best.chi2 > FOUND
    assert best.beta_m[0] == pytest.approx(1.0, abs=0.3)
    t_s = graph.fixes.t_s[best.witnesses]
    assert 0.5 * (t_s[0] + t_s[-1]) == pytest.approx(20.0, abs=2.0)


def test_the_examined_drive_lies_within_its_covariance_of_the_truth():
    graph = graph_of(ramp_and_back(1.0))
    examined = examine(graph, choose(graph, straight(COUNT).T_world_node))
    assert not examined.believed.all()
    east = examined.state.T_enu_node[:, 0, 3]
    assert np.abs(east).max() < 0.5
    doubts = spread_doubts(graph.nodes, examined.moved, COUNT)
    doubt = second_moments(doubts, doubts)
    assert doubt.shape == (COUNT, 6, 6)
    assert (np.linalg.eigvalsh(doubt) > -1e-9).all()


def test_what_is_held_of_the_witnesses_does_not_grow_with_their_number(monkeypatch):
    graph = graph_of(ramp_and_back(1.0))
    choice = all_believed(graph)
    linear = LinearBeliefs(graph, np.ones(len(graph.fixes), bool), np.zeros(0, bool), choice.state)
    whole, everyone = bias_courses(graph, linear), np.arange(len(graph.fixes))
    S = linear.between(everyone)
    np.testing.assert_allclose(S, S.T, atol=1e-9 * np.abs(S).max())
    monkeypatch.setattr(linear_beliefs, "HELD_BYTES", 0)
    monkeypatch.setattr(linear_beliefs, "MOST_TURNED", 5)
    sparing = LinearBeliefs(graph, np.ones(len(graph.fixes), bool), np.zeros(0, bool), choice.state)
    courses = bias_courses(graph, sparing)
    assert len(sparing._columns) == 5 < len(graph.fixes)
    assert [(one.chi2, one.beta_m.tolist()) for one in courses] == [(one.chi2, one.beta_m.tolist()) for one in whole]
    np.testing.assert_array_equal(sparing.between(everyone[4:14]), S[12:42, 12:42])


def test_pairs_near_in_time_are_those_of_comparing_all_with_all():
    t_s = np.random.default_rng(3).uniform(0.0, 20.0, 60)
    i, j = _near_in_time(t_s, 1.5)
    expected = {(a, b) for a in range(60) for b in range(60) if a != b and abs(t_s[a] - t_s[b]) < 1.5}
    assert sorted(zip(i.tolist(), j.tolist(), strict=True)) == sorted(expected)
    assert _near_in_time(t_s[:0], 1.5)[0].shape == (0,)
