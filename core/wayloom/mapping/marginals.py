"""Covariances of the poses of a solved pose graph."""

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.mapping.block_cholesky import NotPositiveDefiniteError, block_factor
from wayloom.mapping.descent import place_at
from wayloom.mapping.pose_graph_equations import graph_equations
from wayloom.mapping.pose_graph_types import PLANAR_ROWS, PoseGraph, PoseGraphSolution

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def left_covariances(graph: PoseGraph, solution: PoseGraphSolution, rows: IntArray | None = None) -> FloatArray:
    """(k, 6, 6) m^2 and rad^2, of the left perturbation (v, omega) of T_world_node at rows (k,), or of all poses.

    Relative to the first pose where there are no priors. Loops that are left out tell nothing. In the plane, z, roll
    and pitch have none.
    Raises InputError where the priors leave a direction free.
    """
    equations = graph_equations(graph)
    weight = np.concatenate([solution.weight, np.ones(len(graph.priors.pose))])
    state = equations.state(solution.T_world_node)
    diagonal, blocks, _ = equations.normal(state, place_at(equations, state, weight).errors, weight)
    try:
        own = block_factor(equations.pattern, diagonal, blocks).diagonal_of_inverse()
    except NotPositiveDefiniteError as error:
        what = "the poses are not determined: there is a direction that no edge or prior tells"
        raise InputError(what, record=f"pose {error.variable}", remedy="add priors, or take them all away") from error
    own[equations.held] = 0.0
    rows = np.arange(graph.poses) if rows is None else rows
    right = np.zeros((len(rows), 6, 6))
    axes = np.array(PLANAR_ROWS) if graph.planar else np.arange(6)
    right[:, axes[:, None], axes] = own[rows]
    Ad = se3.adjoint(solution.T_world_node[rows])
    covariance = Ad @ right @ np.swapaxes(Ad, 1, 2)
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
