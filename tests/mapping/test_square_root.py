"""What is told of a square root is what dense algebra tells, of unknowns of any size, in a whole and part by part."""

import itertools
from collections import Counter
from collections.abc import Mapping

import gtsam
import numpy as np
import pytest

from wayloom.mapping.square_root import SquareRoot, divided, join_in_pattern

SIZES = {key: 1 + key % 3 for key in range(30)}


WHOLE: dict[int, int] = {}
EIGHTS = {key: key // 8 for key in range(30)}
EVERY_OTHER = {key: key // 10 for key in range(0, 30, 2)}
"""The others are of the part of what names them."""
APART = {key: key % 2 for key in range(30)}
"""Neighbours are never of one part: all is shared."""
PARTS = pytest.mark.parametrize("part_of", [WHOLE, EIGHTS, EVERY_OTHER, APART], ids=["whole", "eights", "every other", "apart"])


def loopy(rng: np.random.Generator) -> gtsam.GaussianFactorGraph:
    """A chain of unknowns of one to three numbers, with loops, and a prior on the first."""
    graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(3)
    graph.add(gtsam.JacobianFactor(0, np.eye(3, SIZES[0]), rng.normal(size=3), unit))
    for a, b in [*((k, k + 1) for k in range(29)), (0, 12), (3, 25), (7, 20), (12, 29)]:
        A, B = rng.normal(size=(3, SIZES[a])), rng.normal(size=(3, SIZES[b]))
        graph.add(gtsam.JacobianFactor(a, A, b, B, rng.normal(size=3), unit))
    return graph


@PARTS
@pytest.mark.parametrize("seed", range(5))
def test_covariances_are_those_of_the_dense_inverse(seed: int, part_of: Mapping[int, int]) -> None:
    graph, pairs = loopy(np.random.default_rng(seed)), [(2, 17), (17, 5), (28, 29)]
    A, _ = graph.jacobian()
    dense, ends = np.linalg.inv(A.T @ A), np.cumsum([SIZES[key] for key in range(30)])
    rows = [np.arange(end - SIZES[key], end) for key, end in enumerate(ends.tolist())]
    join_in_pattern(graph, [pairs[0]], SIZES[2])
    join_in_pattern(graph, [pairs[1]], SIZES[17])
    found, crosses = SquareRoot(graph, part_of).covariances({0, 7, 29}, pairs)
    assert set(found) == {0, 7, 29}
    scale = np.abs(dense).max()
    for key, block in found.items():
        np.testing.assert_allclose(block, dense[np.ix_(rows[key], rows[key])], atol=1e-9 * scale)
    for (a, b), block in zip(pairs, crosses, strict=True):
        np.testing.assert_allclose(block, dense[np.ix_(rows[a], rows[b])], atol=1e-9 * scale)


@PARTS
@pytest.mark.parametrize("seed", range(3))
def test_minimum_and_determinant_are_the_dense_ones(seed: int, part_of: Mapping[int, int]) -> None:
    graph = loopy(np.random.default_rng(seed))
    A, b = graph.jacobian()
    root = SquareRoot(graph, part_of)
    assert root.half_log_determinant() == pytest.approx(0.5 * np.linalg.slogdet(A.T @ A)[1], rel=1e-12)
    found = root.minimum()
    expected = np.linalg.lstsq(A, b, rcond=None)[0]
    np.testing.assert_allclose(np.concatenate([found.at(key) for key in range(30)]), expected, atol=1e-9 * np.abs(expected).max())


def test_each_factor_is_in_one_part_and_what_two_parts_name_is_nobodys_own() -> None:
    graph = loopy(np.random.default_rng(0))
    parts, shared = divided(graph, EIGHTS)
    found = [_keys(graph) for graph in (*(part.factors for part in parts), shared)]
    assert Counter(itertools.chain(*found)) == Counter(_keys(graph))
    assert {frozenset({7, 8}), frozenset({3, 25})} <= set(found[-1])
    for number, part in enumerate(parts):
        assert all(EIGHTS[key] == number for keys in found[number] for key in keys)
        others = itertools.chain(*(keys for row, keys in enumerate(found) if row != number))
        assert set(part.own) == set(itertools.chain(*found[number])) - set(itertools.chain(*others))
    assert sum(len(part.own) for part in parts) > 15


def _keys(graph: gtsam.GaussianFactorGraph) -> list[frozenset[int]]:
    return [frozenset(graph.at(row).keys()) for row in range(graph.size())]
