"""Normal equations of a pose graph, in space or in the plane, over all of its edges and priors.

A prior is an edge from a node that stands for the world and is held; without priors the first pose is held. What is held has a unit
block on the diagonal and none beside it. Inside, poses are perturbed on the right, and errors are those of
`kernels.spatial_edges`: log(Z^-1 T)
= Ad(Z^-1) log(T Z^-1), so that information of the left perturbation becomes Ad(Z)^T Omega Ad(Z) and chi-square is the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.block_cholesky import BlockPattern, block_pattern
from wayloom.mapping.kernels import normal_equations, planar_edges, spatial_edges
from wayloom.mapping.pose_graph_types import PLANAR_ROWS, PoseGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GraphEquations:
    """A pose graph as the solver sees it: N poses and the world as node N, E edges and then the priors as further edges.

    first, second (E + P,); T_first_second (E + P, 4, 4); measured: the same, or (E + P, 3) x, y, heading
    information (E + P, d, d) of the errors; d = 6, or 3 in the plane
    held (N + 1,); slot (E + P,) as `kernels.normal_equations` takes it; pattern of the blocks; pairs: its number of blocks
    """

    first: IntArray
    second: IntArray
    T_first_second: FloatArray
    measured: FloatArray
    information: FloatArray
    held: BoolArray
    slot: IntArray
    pairs: int
    pattern: BlockPattern
    planar: bool

    @property
    def block(self) -> int:
        """d."""
        return 3 if self.planar else 6

    def of(self, kept: BoolArray) -> "GraphEquations":
        """The equations of some of the edges and priors (E + P,), over a pattern of their own."""
        first, second = self.first[kept], self.second[kept]
        rows, columns, slot = block_slots(first, second, self.held)
        return replace(
            self,
            first=first,
            second=second,
            T_first_second=self.T_first_second[kept],
            measured=self.measured[kept],
            information=self.information[kept],
            slot=slot,
            pairs=len(rows),
            pattern=block_pattern(len(self.held), rows, columns),
        )

    def state(self, T_world_node: FloatArray) -> FloatArray:
        """Unknowns at poses (N, 4, 4): with the world, as matrices, or (N + 1, 3) in the plane."""
        T = np.concatenate([T_world_node, np.eye(4)[None]])
        return planar_of(T) if self.planar else T

    def poses(self, state: FloatArray) -> FloatArray:
        """(N, 4, 4) of the unknowns."""
        return spatial_of(state[:-1]) if self.planar else state[:-1]

    def errors(self, state: FloatArray) -> FloatArray:
        """(E + P, d)."""
        out = np.empty((len(self.first), self.block))
        fill = planar_edges.fill_errors if self.planar else spatial_edges.fill_errors
        fill(state, self.first, self.second, self.measured, out)
        return out

    def chi2(self, errors: FloatArray) -> FloatArray:
        """(E + P,) of the errors."""
        out = np.empty(len(errors))
        normal_equations.fill_costs(errors, self.information, out)
        return out

    def normal(self, state: FloatArray, errors: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Diagonal (N + 1, d, d), blocks (pairs, d, d) and gradient (N + 1, d) of half of the weighted chi-square;
        weight (E + P,).
        """
        d = self.block
        diagonal, blocks = np.zeros((len(self.held), d, d)), np.zeros((self.pairs, d, d))
        gradient = np.zeros((len(self.held), d))
        by_first, by_second = np.empty((2, len(self.first), d, d))
        fill = planar_edges.fill_jacobians if self.planar else spatial_edges.fill_jacobians
        fill(state, self.first, self.second, self.measured, errors, by_first, by_second)
        normal_equations.add_edges(
            self.first,
            self.second,
            errors,
            self.information,
            weight,
            by_first,
            by_second,
            self.slot,
            diagonal,
            blocks,
            gradient,
        )
        diagonal[self.held], gradient[self.held] = np.eye(d), 0.0
        return diagonal, blocks, gradient

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
        """The unknowns after a step (N + 1, d), perturbed on the right."""
        if not self.planar:
            return np.asarray(state @ se3.exp(step))
        c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
        x, y = c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]
        return state + np.stack([x, y, step[:, 2]], axis=1)


def graph_equations(graph: PoseGraph) -> GraphEquations:
    """The equations of a graph that has been checked."""
    priors, world = graph.priors, graph.poses
    first = np.concatenate([graph.first, np.full(len(priors.pose), world)]).astype(np.int64)
    second = np.concatenate([graph.second, priors.pose]).astype(np.int64)
    T = np.concatenate([graph.T_first_second, priors.T_world_prior])
    Ad = se3.adjoint(T)
    information = np.swapaxes(Ad, 1, 2) @ np.concatenate([graph.information, priors.information]) @ Ad
    held = np.zeros(graph.poses + 1, np.bool_)
    held[world] = True
    held[0] = len(priors.pose) == 0
    if graph.planar:
        information = information[:, PLANAR_ROWS][:, :, PLANAR_ROWS]
    rows, columns, slot = block_slots(first, second, held)
    pattern = block_pattern(len(held), rows, columns)
    measured = planar_of(T) if graph.planar else T
    return GraphEquations(
        first,
        second,
        T,
        np.ascontiguousarray(measured),
        np.ascontiguousarray(information),
        held,
        slot,
        len(rows),
        pattern,
        graph.planar,
    )


def block_slots(first: IntArray, second: IntArray, held: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Rows and columns (B,) of the blocks off the diagonal, row < column, and where each edge adds to them."""
    free = np.flatnonzero(~(held[first] | held[second]))
    low, high = np.minimum(first, second), np.maximum(first, second)
    pairs, inverse = np.unique(low[free] * len(held) + high[free], return_inverse=True)
    slot = np.full(len(first), len(pairs))
    slot[free] = np.where(first[free] < second[free], inverse, ~inverse)
    return pairs // len(held), pairs % len(held), slot


def planar_of(T: FloatArray) -> FloatArray:
    """(..., 4, 4) to x, y, heading (..., 3)."""
    return np.stack([T[..., 0, 3], T[..., 1, 3], np.arctan2(T[..., 1, 0], T[..., 0, 0])], axis=-1)


def spatial_of(poses: FloatArray) -> FloatArray:
    """x, y, heading (..., 3) to (..., 4, 4)."""
    T = np.zeros((*poses.shape[:-1], 4, 4))
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    T[..., 0, 0], T[..., 0, 1], T[..., 1, 0], T[..., 1, 1] = c, -s, s, c
    T[..., 0, 3], T[..., 1, 3] = poses[..., 0], poses[..., 1]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T
