"""Covariances out of a Bayes tree are those of the dense inverse, of unknowns of any size and of pairs that no factor joins."""

import gtsam
import numpy as np
import pytest

from wayloom.mapping.square_root_covariances import covariances, half_log_determinant, join_in_pattern

SIZES = {key: 1 + key % 3 for key in range(30)}


def loopy(rng: np.random.Generator) -> gtsam.GaussianFactorGraph:
    """A chain of unknowns of one to three numbers, with loops, and a prior on the first."""
    graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(3)
    graph.add(gtsam.JacobianFactor(0, np.eye(3, SIZES[0]), np.zeros(3), unit))
    for a, b in [*((k, k + 1) for k in range(29)), (0, 12), (3, 25), (7, 20), (12, 29)]:
        A, B = rng.normal(size=(3, SIZES[a])), rng.normal(size=(3, SIZES[b]))
        graph.add(gtsam.JacobianFactor(a, A, b, B, np.zeros(3), unit))
    return graph


@pytest.mark.parametrize("seed", range(5))
def test_they_are_those_of_the_dense_inverse(seed: int) -> None:
    graph, pairs = loopy(np.random.default_rng(seed)), [(2, 17), (17, 5), (28, 29)]
    A, _ = graph.jacobian()
    dense, ends = np.linalg.inv(A.T @ A), np.cumsum([SIZES[key] for key in range(30)])
    rows = [np.arange(end - SIZES[key], end) for key, end in enumerate(ends.tolist())]
    join_in_pattern(graph, [pairs[0]], SIZES[2])
    join_in_pattern(graph, [pairs[1]], SIZES[17])
    found, crosses = covariances(graph, {0, 7, 29}, pairs)
    assert set(found) == {0, 7, 29}
    scale = np.abs(dense).max()
    for key, block in found.items():
        np.testing.assert_allclose(block, dense[np.ix_(rows[key], rows[key])], atol=1e-9 * scale)
    for (a, b), block in zip(pairs, crosses, strict=True):
        np.testing.assert_allclose(block, dense[np.ix_(rows[a], rows[b])], atol=1e-9 * scale)


@pytest.mark.parametrize("seed", range(3))
def test_the_determinant_out_of_a_tree_is_the_dense_one(seed: int) -> None:
    graph = loopy(np.random.default_rng(seed))
    A, _ = graph.jacobian()
    tree = graph.eliminateMultifrontal(function=gtsam.EliminateQR)
    assert half_log_determinant(tree) == pytest.approx(0.5 * np.linalg.slogdet(A.T @ A)[1], rel=1e-12)
