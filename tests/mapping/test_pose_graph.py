"""Pose graphs: optimum, bad guesses, false loops, covariances, faults."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.evaluation.g2o_files import read_g2o
from wayloom.evaluation.made_graphs import city_drive, measured_graph, sphere, with_false_groups, with_false_loops
from wayloom.geometry import se3
from wayloom.mapping.marginals import left_covariances
from wayloom.mapping.pose_graph import optimise_pose_graph
from wayloom.mapping.pose_graph_types import PoseGraph, PosePriors

FloatArray = NDArray[np.float64]
ORDER = [3, 4, 5, 0, 1, 2]


def gtsam_graph(graph: PoseGraph) -> gtsam.NonlinearFactorGraph:
    """The same edges as gtsam's: right perturbation, order (omega, v)."""
    out = gtsam.NonlinearFactorGraph()
    Ad = se3.adjoint(graph.T_first_second)
    right = np.swapaxes(Ad, 1, 2) @ graph.information @ Ad
    for i, j, T, information in zip(graph.first.tolist(), graph.second.tolist(), graph.T_first_second, right, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(information[np.ix_(ORDER, ORDER)])
        out.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(T), noise))
    return out


def test_the_optimum_without_a_guess_is_gtsams_and_no_lower_cost_is_near() -> None:
    made = sphere(8, 12, 0.1, 0.05, seed=1)
    solution = optimise_pose_graph(made.graph)
    factors, values = gtsam_graph(made.graph), gtsam.Values()
    for k, T in enumerate(solution.T_world_node):
        values.insert(k, gtsam.Pose3(T))
    assert factors.error(values) == pytest.approx(solution.cost, rel=1e-9)
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)))
    better = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    assert factors.error(better) == pytest.approx(solution.cost, rel=1e-7)


def test_random_rotations_as_a_guess_lead_to_the_optimum() -> None:
    made = sphere(8, 12, 0.1, 0.05, seed=2)
    turns = np.concatenate([np.zeros((96, 3)), np.random.default_rng(3).normal(size=(96, 3))], axis=1)
    solution = optimise_pose_graph(made.graph, made.T_world_true @ se3.exp(3.0 * turns))
    assert solution.cost == pytest.approx(optimise_pose_graph(made.graph, made.T_world_true).cost, rel=1e-8)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tenth_of_false_loops_changes_nothing(seed: int) -> None:
    made = sphere(8, 12, 0.05, 0.01, seed=seed)
    false = with_false_loops(made.graph, len(made.graph) // 20, seed=seed)
    clean, solution = optimise_pose_graph(made.graph), optimise_pose_graph(false)
    assert np.array_equal(solution.weight > 0.0, np.arange(len(false)) < len(made.graph))
    np.testing.assert_allclose(solution.T_world_node, clean.T_world_node, atol=1e-6)


@pytest.mark.parametrize("seed", [1, 2])
def test_groups_of_false_loops_that_agree_with_each_other_change_nothing(seed: int) -> None:
    made = sphere(10, 20, 0.02, 0.005, seed=seed)
    false = with_false_groups(made.graph, 24, 6, seed=seed)
    clean, solution = optimise_pose_graph(made.graph), optimise_pose_graph(false)
    assert np.array_equal(solution.weight > 0.0, np.arange(len(false)) < len(made.graph))
    np.testing.assert_allclose(solution.T_world_node, clean.T_world_node, atol=1e-6)


def test_false_loops_change_nothing_where_the_odometry_lies_in_parts() -> None:
    made = sphere(10, 20, 0.02, 0.005, seed=3)
    rows = np.flatnonzero(~((made.graph.first % 40 == 20) & ~made.graph.is_loop))
    g = made.graph
    parts = replace(
        g, first=g.first[rows], second=g.second[rows], T_first_second=g.T_first_second[rows], information=g.information[rows]
    )
    parts = replace(parts, is_loop=g.is_loop[rows])
    false = with_false_loops(parts, 12, seed=3)
    clean, solution = optimise_pose_graph(parts), optimise_pose_graph(false)
    assert np.array_equal(solution.weight > 0.0, np.arange(len(false)) < len(parts))
    np.testing.assert_allclose(solution.T_world_node, clean.T_world_node, atol=1e-6)


def test_planar_poses_stay_in_the_plane_and_measure_headings_over_half_a_turn() -> None:
    turn = np.arange(24) * (2.0 * np.pi / 8.0)
    xi = np.zeros((24, 6))
    xi[:, 5] = turn
    T = se3.exp(xi)
    T[:, :2, 3] = 10.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pairs = np.stack([np.arange(16), np.arange(8, 24)], axis=1)
    graph = replace(measured_graph(T, pairs, 1e-6, 1e-6, seed=1).graph, planar=True)
    steps = se3.inverse(T[graph.first]) @ T[graph.second]
    solution = optimise_pose_graph(replace(graph, T_first_second=steps))
    np.testing.assert_allclose(se3.inverse(T[:1]) @ T, solution.T_world_node, atol=1e-7)


def dense_covariances(graph: PoseGraph, T: FloatArray) -> FloatArray:
    """Left covariances by numeric differentiation and a dense inverse; weights one."""

    def errors(step: FloatArray) -> FloatArray:
        moved = se3.exp(step.reshape(-1, 6)) @ T
        off = [
            se3.log(se3.inverse(moved[i]) @ moved[j] @ se3.inverse(Z))
            for i, j, Z in zip(graph.first, graph.second, graph.T_first_second, strict=True)
        ]
        prior = [se3.log(moved[i] @ se3.inverse(Z)) for i, Z in zip(graph.priors.pose, graph.priors.T_world_prior, strict=True)]
        return np.concatenate(off + prior)

    h, n = 1e-5, 6 * graph.poses
    J = np.stack([(errors(h * e) - errors(-h * e)) / (2.0 * h) for e in np.eye(n)], axis=1)
    omega = np.concatenate([graph.information, graph.priors.information])
    H = sum(J[6 * k : 6 * k + 6].T @ omega[k] @ J[6 * k : 6 * k + 6] for k in range(len(omega)))
    free = np.arange(n) >= (0 if len(graph.priors.pose) else 6)
    out = np.zeros((n, n))
    out[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)])
    return np.array([out[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(graph.poses)])


@pytest.mark.parametrize("with_priors", [False, True])
def test_left_covariances_are_those_of_a_dense_inverse(with_priors: bool) -> None:
    made = sphere(3, 5, 0.01, 0.002, seed=4)
    graph = made.graph
    if with_priors:
        priors = PosePriors(np.array([2, 9]), made.T_world_true[[2, 9]], np.tile(np.diag([25.0] * 3 + [400.0] * 3), (2, 1, 1)))
        graph = replace(graph, priors=priors)
    solution = optimise_pose_graph(graph)
    rows = np.array([0, 7, 14])
    expected = dense_covariances(graph, solution.T_world_node)[rows]
    np.testing.assert_allclose(left_covariances(graph, solution, rows), expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_errors_of_many_drives_are_as_large_as_their_covariances_say() -> None:
    nees = []
    for seed in range(40):
        made = sphere(4, 8, 0.02, 0.003, seed=seed)
        solution = optimise_pose_graph(made.graph)
        T_true = se3.inverse(made.T_world_true[:1]) @ made.T_world_true
        xi = np.array([se3.log(solution.T_world_node[k] @ se3.inverse(T_true[k])) for k in (10, 31)])
        nees += [
            e @ np.linalg.solve(C, e) for e, C in zip(xi, left_covariances(made.graph, solution, np.array([10, 31])), strict=True)
        ]
    # 80 values, pairs of which are correlated: the mean of chi-square with 6 degrees scatters by sqrt(12 / 40) at
    # most; three of these
    assert abs(np.mean(nees) - 6.0) < 3.0 * np.sqrt(12.0 / 40.0)


def test_a_graph_in_two_parts_needs_a_prior_for_each() -> None:
    made = sphere(4, 6, 0.05, 0.01, seed=5)
    cut = (made.graph.first < 12) == (made.graph.second < 12)
    g = made.graph
    apart = replace(
        g, first=g.first[cut], second=g.second[cut], T_first_second=g.T_first_second[cut], information=g.information[cut]
    )
    apart = replace(apart, is_loop=g.is_loop[cut])
    with pytest.raises(InputError, match="2 parts that no edge joins, 1 of them without a prior"):
        optimise_pose_graph(apart)
    priors = PosePriors(np.array([0, 23]), made.T_world_true[[0, 23]], np.tile(1e4 * np.eye(6), (2, 1, 1)))
    solution = optimise_pose_graph(replace(apart, priors=priors))
    assert np.linalg.norm(solution.T_world_node[:, :3, 3] - made.T_world_true[:, :3, 3], axis=1).max() < 1.0


def test_faults_name_the_edge() -> None:
    graph = sphere(3, 5, 0.05, 0.01, seed=6).graph
    itself = graph.second.copy()
    itself[4] = graph.first[4]
    with pytest.raises(InputError, match="edge 4: joins a pose with itself"):
        optimise_pose_graph(replace(graph, second=itself))
    T = graph.T_first_second.copy()
    T[3, 0, 3] = np.nan
    with pytest.raises(InputError, match="edge 3: holds values that are not finite"):
        optimise_pose_graph(replace(graph, T_first_second=T))
    information = graph.information.copy()
    information[2, 0, 0] = -1.0
    with pytest.raises(InputError, match="edge 2: has information that is negative somewhere"):
        optimise_pose_graph(replace(graph, information=information))
    with pytest.raises(InputError, match="edge 0: names pose"):
        optimise_pose_graph(replace(graph, poses=1))


def test_two_measurements_of_one_step_count_as_two_witnesses() -> None:
    T = se3.exp(np.zeros((2, 6)))
    T[:, 0, 3] = 1.0, 2.0
    two = np.zeros(2, np.int64)
    graph = PoseGraph(2, two, two + 1, T, np.tile(np.eye(6), (2, 1, 1)), np.zeros(2, np.bool_))
    solution = optimise_pose_graph(graph)
    assert solution.T_world_node[1, 0, 3] == pytest.approx(1.5)
    np.testing.assert_allclose(left_covariances(graph, solution)[1], 0.5 * np.eye(6), atol=0.05)  # half, but for the chart's slope


def test_the_result_has_the_same_bits_with_any_number_of_threads() -> None:
    program = (
        "from wayloom.evaluation.made_graphs import city_drive, with_false_loops;"
        "from wayloom.mapping.pose_graph import optimise_pose_graph; import hashlib;"
        "g = with_false_loops(city_drive(1500, 60, 1).graph, 6, 1); s = optimise_pose_graph(g);"
        "print(hashlib.sha256(s.T_world_node.tobytes() + s.weight.tobytes()).hexdigest())"
    )
    threads = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    digests = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **dict.fromkeys(threads, count), "PYTHONPATH": os.pathsep.join(sys.path)},
            check=True,
            capture_output=True,
        ).stdout
        for count in ("1", "2")
    }
    assert len(digests) == 1


def test_a_drive_through_a_city_ends_where_it_was() -> None:
    made = city_drive(3000, 150, seed=1)
    solution = optimise_pose_graph(made.graph, made.T_world_odometry)
    T_true = se3.inverse(made.T_world_true[:1]) @ made.T_world_true
    off, before = (
        np.linalg.norm(T[:, :3, 3] - T_true[:, :3, 3], axis=1).max() for T in (solution.T_world_node, made.T_world_odometry)
    )
    assert off < 0.5 * before


def test_a_public_graph_with_a_tenth_of_false_loops_reaches_the_clean_optimum(data_dir: Path) -> None:
    path = data_dir / "pose_graphs" / "manhattan.g2o"
    if not path.exists():
        pytest.skip(f"no {path}")
    graph = read_g2o(path).graph
    false = with_false_loops(graph, int(graph.is_loop.sum()) // 10, seed=0)
    clean, solution = optimise_pose_graph(graph), optimise_pose_graph(false)
    assert np.array_equal(solution.weight > 0.0, np.arange(len(false)) < len(graph))
    assert solution.cost == pytest.approx(clean.cost, rel=1e-6)
