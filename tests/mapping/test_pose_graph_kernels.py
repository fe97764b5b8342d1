"""The pose graph's kernels against slow, obvious twins: ordering, factorisation, selected inverse, errors and Jacobians."""

import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.block_cholesky import NotPositiveDefiniteError, block_factor, block_pattern
from wayloom.mapping.kernels import dissection, ordering, planar_edges, spatial_edges, supernodes

pytestmark = pytest.mark.kernels
FloatArray = NDArray[np.float64]


def random_matrix(n: int, extra: int, d: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    """A dense positive definite matrix (nd, nd), its blocks on the diagonal and beside it, and the pairs (P, 2) of the latter."""
    rng = np.random.default_rng(seed)
    ends = np.concatenate([np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), rng.integers(0, n, (extra, 2))])
    pairs = np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0)
    turned = rng.random(len(pairs)) < 0.5
    pairs[turned] = pairs[turned, ::-1]
    blocks = rng.normal(size=(len(pairs), d, d))
    A = np.zeros((n, d, n, d))
    for (i, j), block in zip(pairs.tolist(), blocks, strict=True):
        A[i, :, j, :], A[j, :, i, :] = block, block.T
    A = A.reshape(n * d, n * d)
    A += (np.abs(np.linalg.eigvalsh(A)).max() + 1.0) * np.eye(n * d)
    diagonal = np.array([A.reshape(n, d, n, d)[i, :, i, :] for i in range(n)])
    return A, diagonal, blocks, pairs


@pytest.mark.parametrize(
    ("n", "extra", "d"), [(1, 0, 3), (2, 0, 6), (12, 6, 6), (40, 60, 3), (30, 25, 2), (60, 40, 6), (50, 40, 2)]
)
def test_a_sparse_solution_and_inverse_are_those_of_the_dense_matrix(n: int, extra: int, d: int) -> None:
    A, diagonal, blocks, pairs = random_matrix(n, extra, d, seed=n)
    factor = block_factor(block_pattern(n, pairs[:, 0].copy(), pairs[:, 1].copy()), diagonal, blocks)
    right = np.random.default_rng(1).normal(size=(n, d, 2))
    np.testing.assert_allclose(factor.solve(right).reshape(n * d, 2), np.linalg.solve(A, right.reshape(n * d, 2)), atol=1e-13)
    inverse = np.linalg.inv(A).reshape(n, d, n, d)
    np.testing.assert_allclose(factor.diagonal_of_inverse(), [inverse[i, :, i, :] for i in range(n)], atol=1e-13)


@pytest.mark.parametrize(("n", "extra"), [(12, 6), (40, 20)])
def test_the_variable_at_which_a_matrix_is_singular_is_named(n: int, extra: int) -> None:
    _, diagonal, blocks, pairs = random_matrix(n, extra, 3, seed=3)
    diagonal[7] = 0.0
    with pytest.raises(NotPositiveDefiniteError) as raised:
        block_factor(block_pattern(n, pairs[:, 0].copy(), pairs[:, 1].copy()), diagonal, blocks)
    assert raised.value.variable == 7


def fill_of(order: NDArray[np.int64], pairs: NDArray[np.int64]) -> int:
    """Entries that elimination in this order makes, by sets."""
    neighbours: dict[int, set[int]] = {int(i): set() for i in order}
    for i, j in pairs.tolist():
        neighbours[i].add(j)
        neighbours[j].add(i)
    entries = 0
    for i in order.tolist():
        around = neighbours.pop(i)
        entries += len(around)
        for j in around:
            neighbours[j] = (neighbours[j] | around) - {i, j}
    return entries


def grid_pairs(side: int) -> NDArray[np.int64]:
    """Neighbours in a square grid."""
    index = np.arange(side * side).reshape(side, side)
    across, down = (np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:])))
    return np.concatenate([across, down])


def test_both_orderings_hold_every_variable_once_and_fill_a_grid_less_than_rows_do() -> None:
    pairs = grid_pairs(20)
    start, adjacent = supernodes.compressed(400, pairs[:, 0].copy(), pairs[:, 1].copy())
    by_rows = fill_of(np.arange(400), pairs)
    for order in (ordering.minimum_degree(start, adjacent.copy()), dissection.nested_dissection(start, adjacent)):
        assert sorted(order.tolist()) == list(range(400))
        assert fill_of(order, pairs) < 0.6 * by_rows


def test_column_counts_are_those_of_elimination() -> None:
    pairs = grid_pairs(9)
    start, adjacent = supernodes.compressed(81, pairs[:, 0].copy(), pairs[:, 1].copy())
    order = ordering.minimum_degree(start, adjacent.copy())
    parent = supernodes.elimination_tree(start, adjacent, order)
    assert supernodes.column_counts(start, adjacent, order, parent).sum() == fill_of(order, pairs)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.049, 0.051, 1.0, 3.0, np.pi - 1e-9])
def test_the_error_of_an_edge_is_the_logarithm_of_what_remains(angle: float) -> None:
    rng = np.random.default_rng(5)
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    T = se3.exp(rng.normal(size=(2, 6)))
    Z = se3.inverse(T[0]) @ T[1] @ se3.inverse(se3.exp(xi))
    errors = np.empty((1, 6))
    spatial_edges.fill_errors(T, np.array([0]), np.array([1]), Z[None], errors)
    np.testing.assert_allclose(errors[0], xi, atol=1e-7 if angle > 3.1 else 1e-12)


def central(function, size: int, h: float = 1e-6) -> FloatArray:  # type: ignore[no-untyped-def]
    """Jacobian by central differences."""
    return np.stack([(function(h * e) - function(-h * e)) / (2.0 * h) for e in np.eye(size)], axis=1)


@pytest.mark.parametrize("angle", [0.0, 0.03, 0.4, 2.5])
def test_the_jacobians_in_space_are_the_slopes_of_the_error(angle: float) -> None:
    rng = np.random.default_rng(6)
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    T = se3.exp(rng.normal(size=(2, 6)))
    Z = se3.inverse(T[0]) @ T[1] @ se3.inverse(se3.exp(xi))

    def error(first: FloatArray, second: FloatArray) -> FloatArray:
        out = np.empty((1, 6))
        moved = np.stack([T[0] @ se3.exp(first), T[1] @ se3.exp(second)])
        spatial_edges.fill_errors(moved, np.array([0]), np.array([1]), Z[None], out)
        return out[0]

    by_first, by_second = np.empty((6, 6)), np.empty((6, 6))
    spatial_edges.fill_edge_jacobians(T[0], T[1], error(np.zeros(6), np.zeros(6)), by_first, by_second)
    np.testing.assert_allclose(by_first, central(lambda d: error(d, np.zeros(6)), 6), atol=2e-8)
    np.testing.assert_allclose(by_second, central(lambda d: error(np.zeros(6), d), 6), atol=2e-8)


def test_the_jacobians_in_the_plane_are_the_slopes_of_the_error() -> None:
    rng = np.random.default_rng(7)
    poses, z = rng.normal(size=(2, 3)), rng.normal(size=3)

    def error(k: int, d: FloatArray) -> FloatArray:
        moved, out = poses.copy(), np.empty((1, 3))
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        moved[k] += [c * d[0] - s * d[1], s * d[0] + c * d[1], d[2]]
        planar_edges.fill_errors(moved, np.array([0]), np.array([1]), z[None], out)
        return out[0]

    jacobians = np.empty((2, 3, 3))
    planar_edges.fill_edge_jacobians(poses[0], poses[1], z, jacobians[0], jacobians[1])
    for k in range(2):
        np.testing.assert_allclose(jacobians[k], central(lambda d, k=k: error(k, d), 3), atol=1e-9)
