"""Covariances of a square root of the information, clique by clique from the root of its Bayes tree down.

A clique's rows of R, of its frontal unknowns F and its separator P, are [R S]. With K = R^-1 S

    C_FF = R^-1 R^-T + K C_PP K^T,      C_FP = -K C_PP

(Kaess and Dellaert 2009, Covariance recovery from a square root information matrix for data association), and C_PP is a part of
the covariance of the parent clique, which holds P. So what is held is the separators of cliques that are still to come, however
long the drive, and not a cache of what every clique tells of every other.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def join_in_pattern(linear: gtsam.GaussianFactorGraph, pairs: Sequence[tuple[int, int]], size: int) -> None:
    """Add factors that say nothing of pairs of unknowns of this size, so that `covariances` can tell of the two together."""
    nothing, model = np.zeros((1, size)), gtsam.noiseModel.Unit.Create(1)
    for first, second in pairs:
        linear.add(gtsam.JacobianFactor(first, nothing, second, nothing, np.zeros(1), model))


def covariances(
    linear: gtsam.GaussianFactorGraph, wanted: Collection[int], pairs: Sequence[tuple[int, int]]
) -> tuple[dict[int, FloatArray], list[FloatArray]]:
    """Of each wanted unknown its covariance, and of each pair that of its first (rows) with its second (columns).

    linear : whitened factors, eliminated by QR as in `DriveEquations.tree`; pairs : of unknowns that some factor joins
    """
    zeros = linear.gradientAtZero()
    sizes = {int(key): len(zeros.at(key)) for key in linear.keyVector()}
    partners: dict[int, list[tuple[int, int]]] = {}
    for k, (first, second) in enumerate(pairs):
        partners.setdefault(first, []).append((k, second))
        partners.setdefault(second, []).append((k, first))
    found: dict[int, FloatArray] = {}
    crosses = [np.zeros((0, 0))] * len(pairs)
    tree = linear.eliminateMultifrontal(function=gtsam.EliminateQR)
    coming = [(_clique(node, sizes), np.zeros((0, 0))) for node in tree.roots()]
    while coming:
        clique, of_separator = coming.pop()
        whole, places = _with_frontals(clique.node.conditional(), of_separator), clique.places
        for own in clique.frontals:
            if own in wanted:
                found[own] = whole[np.ix_(places[own], places[own])]
            for k, other in partners.get(own, ()):
                if other in places:
                    first, second = pairs[k]
                    crosses[k] = whole[np.ix_(places[first], places[second])]
        for row in range(clique.node.nrChildren()):
            child = _clique(clique.node[row], sizes)
            kept = np.concatenate([places[key] for key in child.separator])
            coming.append((child, whole[np.ix_(kept, kept)]))
    return found, crosses


def half_log_determinant(tree: gtsam.GaussianBayesTree) -> float:
    """Half the logarithm of the information's determinant: the sum of those of all diagonals of R, of either sign."""
    total, coming = 0.0, list(tree.roots())
    while coming:
        node = coming.pop()
        total += float(np.log(np.abs(np.diagonal(node.conditional().R()))).sum())
        coming += [node[row] for row in range(node.nrChildren())]
    return total


@dataclass(frozen=True, slots=True)
class _Clique:
    """A clique, its frontal unknowns and those of its separator, and the rows of each in a covariance of all of them."""

    node: gtsam.GaussianBayesTreeClique
    frontals: list[int]
    separator: list[int]
    places: dict[int, NDArray[np.intp]]


def _clique(node: gtsam.GaussianBayesTreeClique, sizes: dict[int, int]) -> _Clique:
    conditional = node.conditional()
    keys = list(conditional.keys())
    ends = np.cumsum([sizes[key] for key in keys])
    count = int(np.searchsorted(ends, conditional.R().shape[0])) + 1
    places = {key: np.arange(end - sizes[key], end) for key, end in zip(keys, ends.tolist(), strict=True)}
    return _Clique(node, keys[:count], keys[count:], places)


def _with_frontals(rows: gtsam.GaussianConditional, of_separator: FloatArray) -> FloatArray:
    """The covariance of frontals and separator, by that of the separator. (R and S are views: the rows live as long.)"""
    inverse = np.linalg.inv(rows.R())
    if not len(of_separator):
        return np.asarray(inverse @ inverse.T)
    gain = inverse @ rows.S()
    beside = -gain @ of_separator
    return np.block([[inverse @ inverse.T - beside @ gain.T, beside], [beside.T, of_separator]])
