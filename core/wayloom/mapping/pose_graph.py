"""Pose graph optimisation: first guesses, descent, robust weights of loops.

- First guesses: the caller's, the chordal relaxation over all edges, and that over the trusted ones
  (`wayloom.mapping.initialisation`).
- Descent: Gauss-Newton, then Levenberg-Marquardt (`wayloom.mapping.descent`), over our own sparse Cholesky
  (`wayloom.mapping.block_cholesky`).
- Loops: those that agree with their neighbours (`wayloom.mapping.loop_votes`), then graduated non-convexity
  (`wayloom.mapping.robust`).
- Covariances of the poses: `wayloom.mapping.marginals`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import minimum_spanning_tree

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.descent import Descent, descend, place_at
from wayloom.mapping.initialisation import chordal_poses
from wayloom.mapping.loop_paths import closing
from wayloom.mapping.loop_votes import agreeing, plausible, scaled_limit
from wayloom.mapping.pose_graph_checks import check_graph
from wayloom.mapping.pose_graph_equations import GraphEquations, graph_equations
from wayloom.mapping.pose_graph_types import PoseGraph, PoseGraphSolution, SolverSettings
from wayloom.mapping.robust import Weighed, graduate, settle, sides, weighed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
DEFAULTS = SolverSettings()
MOST_RESTARTS = 5
MOST_SYSTEMS = 20  # of a descent among doubtful loops: those that need more are on the wrong way
MOST_AGREE = 0.5  # of the loops: with more, what agrees is start enough
FIRST_SYSTEMS = 6  # of a descent to where more loops are judged: it need not end
MOST_EXTENSIONS = 3
VOTES = 0.95  # of chi-square: what share of right loops the start is made of, at most; the others come in by the poses' covariances
LATE = 1e-4  # mu from there: loops a hundred times off their limit keep some weight


def optimise_pose_graph(
    graph: PoseGraph, T_world_node: FloatArray | None = None, settings: SolverSettings = DEFAULTS
) -> PoseGraphSolution:
    """The most likely poses.

    T_world_node : (N, 4, 4) first guess, if there is one; without priors its first pose stays (the identity without a guess)
    Loops that agree with their neighbours and with the ways between their ends are the start, where they are most but not all; else
    all edges are, and where these agree as their information says, that is the solution. Otherwise loops are weighed (unless
    settings.robust is off).
    Raises InputError where the graph cannot be solved (`wayloom.mapping.pose_graph_checks`).
    """
    check_graph(graph)
    equations = graph_equations(graph)
    loops = np.zeros(len(equations.first), np.bool_)
    loops[: len(graph)] = graph.is_loop & settings.robust
    c2 = float(chi_square_quantile(settings.confidence, equations.block))
    agreed = closing(equations, loops, agreeing(equations, loops, c2), float(chi_square_quantile(VOTES, equations.block)))
    search = _search(equations, loops, agreed, T_world_node, settings)
    if MOST_AGREE * loops.sum() <= agreed.sum() < loops.sum():
        return _solution(graph, equations, search.extended(agreed, c2), "agreeing loops")
    most = min(MOST_SYSTEMS, settings.max_iterations) if loops.any() else settings.max_iterations
    plain, start = _least_squares(equations, T_world_node, most, settings.converged)
    chi2 = equations.chi2(equations.errors(plain.state))
    if not (chi2[loops] > c2).any():
        if plain.iterations == most:
            rest = descend(equations, plain.state, np.ones(len(chi2)), settings.max_iterations - most, settings.converged)
            plain = replace(rest, iterations=most + rest.iterations)
        return _solution(graph, equations, Weighed(plain.state, np.ones(len(chi2)), plain.cost, plain.iterations), start)
    weighed, start = _without_false_loops(search, agreed, T_world_node, c2)
    return _solution(graph, equations, weighed, start, plain.iterations)


def _least_squares(equations: GraphEquations, T_world_node: FloatArray | None, most: int, converged: float) -> tuple[Descent, str]:
    """The descent with all edges trusted, from the better of the caller's guess and the chordal one, and which that was."""
    every = np.ones(len(equations.first))
    guesses = {"chordal": chordal_poses(equations, _held(equations, T_world_node), every)}
    if T_world_node is not None:
        guesses["given"] = T_world_node
    states = {name: equations.state(T) for name, T in guesses.items()}
    start = min(states, key=lambda name: place_at(equations, states[name], every).cost)
    return descend(equations, states[start], every, most, converged), start


def _without_false_loops(search: "Search", agreed: BoolArray, T_world_node: FloatArray | None, c2: float) -> tuple[Weighed, str]:
    """Truncated least squares by graduation, and where it began: at the loops that agree with their neighbours (E + P,), at
    the trusted edges alone and at the caller's guess, whichever ends lowest.
    """
    equations = search.equations
    first = search.over(np.where(agreed, 1.0, search.tree))
    c2 = min(c2, scaled_limit(equations.chi2(equations.errors(first.state))[agreed], c2, equations.block))
    ends = {
        "agreeing loops": search.graduated(first, c2, LATE),
        "trusted edges": search.graduated(search.over(search.tree), c2, 0.0),
    }
    if T_world_node is not None:
        ends["given"] = search.settled(equations.state(T_world_node), c2)
    start = min(ends, key=lambda name: ends[name].cost)
    return replace(ends[start], iterations=sum(end.iterations for end in ends.values())), start


def _search(
    equations: GraphEquations, loops: BoolArray, agreed: BoolArray, T_world_node: FloatArray | None, settings: SolverSettings
) -> "Search":
    doubt = loops.astype(np.int64) + (loops & ~agreed)
    tree = np.where(loops & ~_spanning(equations, doubt), 0.0, 1.0)
    return Search(equations, loops, tree, _held(equations, T_world_node), settings)


@dataclass(frozen=True, slots=True)
class Search:
    """Descents among doubtful loops.

    loops  (E + P,) edges that are weighed
    tree   (E + P,) 1 for trusted edges, and loops without which parts would be loose
    T_held (N + 1, 4, 4) where held poses are
    """

    equations: GraphEquations
    loops: BoolArray
    tree: FloatArray
    T_held: FloatArray
    settings: SolverSettings

    def extended(self, agreed: BoolArray, c2: float) -> Weighed:
        """From loops (E + P,) that agree with their neighbours to those that may be right by the poses' covariances: the many
        false ones would fill the factors of every step.
        """
        equations, limit, kept = self.equations, c2, agreed | (self.tree > 0.0)
        part = self.part(kept)
        first = part.over(np.ones(int(kept.sum())), FIRST_SYSTEMS)
        systems = first.iterations
        for _ in range(MOST_EXTENSIONS):
            told = scaled_limit(equations.chi2(equations.errors(first.state))[agreed], c2, equations.block)
            limit = min(limit, told)  # false loops that came in bend what agrees: it never tells a wider limit than before
            wider = kept | plausible(equations, part.equations, first.state, limit)
            if (wider == kept).all():
                break
            kept, part = wider, self.part(wider)
            first = descend(part.equations, first.state, np.ones(int(kept.sum())), FIRST_SYSTEMS, self.settings.converged)
            systems += first.iterations
        best = part.graduated(first, limit, LATE)
        final = self.settled(best.state, limit)
        return replace(final, iterations=systems + best.iterations + final.iterations)

    def part(self, kept: BoolArray) -> "Search":
        """The same among some of the edges (E + P,)."""
        return replace(self, equations=self.equations.of(kept), loops=self.loops[kept], tree=self.tree[kept])

    def over(self, weight: FloatArray, most: int = MOST_SYSTEMS) -> Descent:
        """From the chordal relaxation over weighted edges (E + P,) down their chi-square."""
        start = self.equations.state(chordal_poses(self.equations, self.T_held, weight))
        return descend(self.equations, start, weight, min(most, self.settings.max_iterations), self.settings.converged)

    def settled(self, state: FloatArray, c2: float) -> Weighed:
        """The minimum near a state. Loops that do not count there are left out of the equations: they would fill the factors."""
        most, systems = min(MOST_SYSTEMS, self.settings.max_iterations), 0
        for _ in range(MOST_EXTENSIONS):
            counted = sides(self.equations, state, self.loops, c2) > 0.0
            part = self.part(counted)
            end = settle(part.equations, state, part.loops, c2, most, self.settings.converged)
            state, systems = end.state, systems + end.iterations
            if not (sides(self.equations, state, self.loops, c2)[~counted] > 0.0).any():
                break
        return weighed(self.equations, state, self.loops, c2, systems)

    def graduated(self, first: Descent, c2: float, least_mu: float) -> Weighed:
        """By graduation, then from the chordal relaxation over what that kept, as long as the cost falls."""
        state, systems = graduate(self.equations, first.state, self.loops, c2, least_mu)
        best = self.settled(state, c2)
        systems += first.iterations + best.iterations
        for _ in range(MOST_RESTARTS if (best.weight == 0.0).any() else 0):
            kept = np.maximum(best.weight, self.tree)
            again = self.settled(self.equations.state(chordal_poses(self.equations, self.T_held, kept)), c2)
            systems += again.iterations
            if again.cost >= best.cost * (1.0 - self.settings.converged):
                break
            best = again
        return replace(best, iterations=systems)


def _spanning(equations: GraphEquations, doubt: IntArray) -> BoolArray:
    """(E + P,) edges of a tree over all that edges connect, with as little doubt (E + P,) 0, 1, 2 in it as can be."""
    n, e = len(equations.held), np.arange(len(doubt))
    low, high = np.minimum(equations.first, equations.second), np.maximum(equations.first, equations.second)
    order = np.lexsort((e, doubt, high, low))  # of edges between the same two poses, the surest
    pair = low[order] * n + high[order]
    one = order[np.flatnonzero(np.diff(pair, prepend=-1))]
    tree = minimum_spanning_tree(coo_matrix((1.0 + doubt[one], (low[one], high[one])), shape=(n, n)).tocsr()).tocoo()
    taken = np.isin(low[one] * n + high[one], tree.row.astype(np.int64) * n + tree.col)
    out = np.zeros(len(doubt), np.bool_)
    out[one[taken]] = True
    return out


def _held(equations: GraphEquations, T_world_node: FloatArray | None) -> FloatArray:
    """(N + 1, 4, 4): where held poses are."""
    T = np.tile(np.eye(4), (len(equations.held), 1, 1))
    if T_world_node is not None:
        T[:-1] = T_world_node
    return T


def _solution(graph: PoseGraph, equations: GraphEquations, weighed: Weighed, start: str, before: int = 0) -> PoseGraphSolution:
    place = place_at(equations, weighed.state, weighed.weight)
    chi2 = equations.chi2(place.errors)[: len(graph)]
    T = np.ascontiguousarray(equations.poses(weighed.state))
    return PoseGraphSolution(T, place.cost, weighed.weight[: len(graph)], chi2, weighed.iterations + before, start)
