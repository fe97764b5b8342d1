"""Square root of the information of whitened factors, by QR: minimum, determinant and covariances, of drives of any length.

Of many unknowns, those that only factors of one part of the drive know are eliminated by themselves, which leaves factors of what
the part shares with others; what is shared follows: the receiver, the ends of parts, and whatever loops join. Rows of a part are
made again where they are asked for, and never held: gtsam keeps them with all that they were made of.

Covariances are found clique by clique from the root of a Bayes tree down. A clique's rows of R, of its frontal unknowns F and its
separator P, are [R S]. With K = R^-1 S

    C_FF = R^-1 R^-T + K C_PP K^T,      C_FP = -K C_PP

(Kaess and Dellaert 2009, Covariance recovery from a square root information matrix for data association), and C_PP is a part of
the covariance of the parent clique, which holds P, or, for a part's root, of a clique of what is shared.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
NOWHERE, SHARED = -2, -1
"""Parts of a factor that names no unknown of a known part, and of what belongs to no part alone."""


def join_in_pattern(linear: gtsam.GaussianFactorGraph, pairs: Sequence[tuple[int, int]], size: int) -> None:
    """Add factors that say nothing of pairs of unknowns of this size, so that `covariances` can tell of the two together."""
    nothing, model = np.zeros((1, size)), gtsam.noiseModel.Unit.Create(1)
    for first, second in pairs:
        linear.add(gtsam.JacobianFactor(first, nothing, second, nothing, np.zeros(1), model))


@dataclass(frozen=True, slots=True)
class Part:
    """Factors of one part of a drive, and its own unknowns, which no other factor names."""

    factors: gtsam.GaussianFactorGraph
    own: list[int]


def divided(linear: gtsam.GaussianFactorGraph, part_of: Mapping[int, int]) -> tuple[list[Part], gtsam.GaussianFactorGraph]:
    """The factors by parts 0, 1, …, and those that belong to none.

    part_of : the part of some unknowns; a factor is of the part of all that it names, and unknowns that are not in here, of the
        part of all factors that name them
    """
    keys = [list(linear.at(row).keys()) for row in range(linear.size())]
    home = [_only((part_of[key] for key in row if key in part_of), NOWHERE) for row in keys]
    of_key = _parts_of_keys(keys, home)
    for row, part in enumerate(home):
        if part == NOWHERE:
            home[row] = _only((of_key[key] for key in keys[row]), SHARED)
    of_key = _parts_of_keys(keys, home)
    count = 1 + max(home, default=SHARED)
    graphs = [gtsam.GaussianFactorGraph() for _ in range(count + 1)]  # what is shared is the last
    for row, part in enumerate(home):
        graphs[part].push_back(linear.at(row))  # `add` would copy it
    own: list[list[int]] = [[] for _ in range(count)]
    for key, part in of_key.items():
        if part >= 0:
            own[part].append(key)
    return [Part(graph, keys) for graph, keys in zip(graphs, own, strict=False)], graphs[-1]


def _only(parts: Iterable[int], otherwise: int) -> int:
    """The part, where they are all one; what is shared, where they are not."""
    found = set(parts)
    return otherwise if not found else found.pop() if len(found) == 1 else SHARED


def _parts_of_keys(keys: Sequence[Sequence[int]], home: Sequence[int]) -> dict[int, int]:
    """For each unknown the part of all factors that name it, but for those that are nowhere; SHARED where there is none."""
    found: dict[int, int] = {}
    for row, part in zip(keys, home, strict=True):
        for key in row:
            before = found.setdefault(key, part)
            if NOWHERE not in (before, part) and before != part:
                found[key] = SHARED
            elif before == NOWHERE:
                found[key] = part
    return {key: SHARED if part == NOWHERE else part for key, part in found.items()}


class SquareRoot:
    """R of some whitened factors; `part_of` as `divided` has it, by default a single whole."""

    def __init__(self, linear: gtsam.GaussianFactorGraph, part_of: Mapping[int, int] = {}) -> None:
        self._linear = linear
        self._parts, self._shared = divided(linear, part_of) if part_of else ([], linear)

    def minimum(self) -> gtsam.VectorValues:
        """All unknowns where the factors' squares are least."""
        tree = self._shared_tree([_net_of(part)[1] for part in self._parts])
        if not self._parts:
            return tree.optimize()
        shared, found = tree.optimize(), self._linear.gradientAtZero()  # a value of each unknown, to be put in its place
        found.update(shared)
        for part in self._parts:
            net, left = _net_of(part)
            border = gtsam.VectorValues()
            for key in left.keyVector():
                border.insert(key, shared.at(key))
            found.update(net.optimize(border))
        return found

    def half_log_determinant(self) -> float:
        """Half the logarithm of the information's determinant: the sum of those of all diagonals of R, of either sign."""
        total, left = 0.0, []
        for part in self._parts:
            net, remaining = _net_of(part)
            total += sum(_log_diagonal(net.at(row)) for row in range(net.size()))
            left.append(remaining)
        coming = list(self._shared_tree(left).roots())
        while coming:
            node = coming.pop()
            total += _log_diagonal(node.conditional())
            coming += [node[row] for row in range(node.nrChildren())]
        return total

    def covariances(
        self, wanted: Collection[int], pairs: Sequence[tuple[int, int]]
    ) -> tuple[dict[int, FloatArray], list[FloatArray]]:
        """Of each wanted unknown its covariance, and of each pair that of its first (rows) with its second (columns).

        pairs : of unknowns that some factor joins
        """
        asked = _Asked(wanted, pairs, self._sizes())
        left = [_tree_of(part)[1] for part in self._parts]
        asked.wait_for({frozenset(factors.at(row).keys()) for factors in left for row in range(factors.size())})
        asked.walk((root, np.zeros((0, 0))) for root in self._shared_tree(left).roots())
        for part in self._parts:
            tree, _ = _tree_of(part)
            asked.walk((root, asked.of_separator(root)) for root in tree.roots())
        return asked.found, asked.crosses

    def _shared_tree(self, left: Sequence[gtsam.GaussianFactorGraph]) -> gtsam.GaussianBayesTree:
        """Of what is shared, by its factors and those that are left of the parts.

        By QR: Cholesky gives up where a heading that nothing observes stands beside millimetres.
        """
        whole = gtsam.GaussianFactorGraph()
        whole.push_back(self._shared)
        for factors in left:
            whole.push_back(factors)
        return whole.eliminateMultifrontal(function=gtsam.EliminateQR)

    def _sizes(self) -> dict[int, int]:
        one_each = self._linear.gradientAtZero()
        return {int(key): len(one_each.at(key)) for key in self._linear.keyVector()}


def _net_of(part: Part) -> tuple[gtsam.GaussianBayesNet, gtsam.GaussianFactorGraph]:
    """The rows of a part's own unknowns, one after the other, and the factors that are left."""
    return part.factors.eliminatePartialSequential(part.own, function=gtsam.EliminateQR)


def _tree_of(part: Part) -> tuple[gtsam.GaussianBayesTree, gtsam.GaussianFactorGraph]:
    """The same as a tree of cliques; the separator of each root is what one of the factors names."""
    return part.factors.eliminatePartialMultifrontal(part.own, function=gtsam.EliminateQR)


def _log_diagonal(rows: gtsam.GaussianConditional) -> float:
    return float(np.log(np.abs(np.diagonal(rows.R()))).sum())


class _Asked:
    """Covariances that are asked for, found from the roots of trees down."""

    def __init__(self, wanted: Collection[int], pairs: Sequence[tuple[int, int]], sizes: dict[int, int]) -> None:
        self._wanted, self._pairs, self._sizes = wanted, pairs, sizes
        self._partners: dict[int, list[tuple[int, int]]] = {}
        for k, (first, second) in enumerate(pairs):
            self._partners.setdefault(first, []).append((k, second))
            self._partners.setdefault(second, []).append((k, first))
        self._waiting: dict[int, list[frozenset[int]]] = {}
        self._borders: dict[frozenset[int], tuple[FloatArray, dict[int, NDArray[np.intp]]]] = {}
        self.found: dict[int, FloatArray] = {}
        self.crosses = [np.zeros((0, 0))] * len(pairs)

    def wait_for(self, borders: Iterable[frozenset[int]]) -> None:
        """Keep the covariance of each of these sets, which a clique to come holds, for `of_separator`."""
        for border in borders:
            for key in border:
                self._waiting.setdefault(key, []).append(border)

    def of_separator(self, root: gtsam.GaussianBayesTreeClique) -> FloatArray:
        """The covariance of the separator of a part's root, which is one of the sets that were waited for."""
        separator = _Clique.of(root, self._sizes).separator
        if not separator:
            return np.zeros((0, 0))
        whole, places = self._borders[frozenset(separator)]
        rows = np.concatenate([places[key] for key in separator])
        return np.asarray(whole[np.ix_(rows, rows)])

    def walk(self, roots: Iterable[tuple[gtsam.GaussianBayesTreeClique, FloatArray]]) -> None:
        """From these roots, each with the covariance of its separator, down."""
        coming = list(roots)
        while coming:
            node, of_separator = coming.pop()
            clique = _Clique.of(node, self._sizes)
            whole, places = _with_frontals(node.conditional(), of_separator), clique.places
            for own in clique.frontals:
                self._tell(own, whole, places)
            for row in range(node.nrChildren()):
                kept = np.concatenate([places[key] for key in _Clique.of(node[row], self._sizes).separator])
                coming.append((node[row], whole[np.ix_(kept, kept)]))

    def _tell(self, own: int, whole: FloatArray, places: dict[int, NDArray[np.intp]]) -> None:
        """What a clique knows of one of its frontals."""
        if own in self._wanted:
            self.found[own] = whole[np.ix_(places[own], places[own])]
        for k, other in self._partners.get(own, ()):
            if other in places:
                first, second = self._pairs[k]
                self.crosses[k] = whole[np.ix_(places[first], places[second])]
        for border in self._waiting.get(own, ()):
            if border <= places.keys():
                self._borders[border] = whole, places


@dataclass(frozen=True, slots=True)
class _Clique:
    """Frontal unknowns of a clique and those of its separator, and the rows of each in a covariance of all of them."""

    frontals: list[int]
    separator: list[int]
    places: dict[int, NDArray[np.intp]]

    @classmethod
    def of(cls, node: gtsam.GaussianBayesTreeClique, sizes: dict[int, int]) -> "_Clique":
        """A clique's unknowns, whose sizes are these."""
        conditional = node.conditional()
        keys = list(conditional.keys())
        ends = np.cumsum([sizes[key] for key in keys])
        count = int(np.searchsorted(ends, conditional.R().shape[0])) + 1
        places = {key: np.arange(end - sizes[key], end) for key, end in zip(keys, ends.tolist(), strict=True)}
        return cls(keys[:count], keys[count:], places)


def _with_frontals(rows: gtsam.GaussianConditional, of_separator: FloatArray) -> FloatArray:
    """The covariance of frontals and separator, by that of the separator. (R and S are views: the rows live as long.)"""
    inverse = np.linalg.inv(rows.R())
    if not len(of_separator):
        return np.asarray(inverse @ inverse.T)
    gain = inverse @ rows.S()
    beside = -gain @ of_separator
    return np.block([[inverse @ inverse.T - beside @ gain.T, beside], [beside.T, of_separator]])
