"""Pose graphs that cannot be solved, refused with the edge or prior that is to blame."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from wayloom.errors import InputError
from wayloom.mapping.pose_graph_types import PoseGraph

FloatArray = NDArray[np.float64]
NOT_A_ROTATION = 1e-6
ROUNDING = 1e-9  # of an information matrix's largest entry


def check_graph(graph: PoseGraph) -> None:
    """Raises InputError: no poses, rows out of range, edges from a pose to itself, values that are not finite, matrices
    that are no motions, information that is not positive semi-definite, parts that nothing ties to the rest."""
    if graph.poses < 1:
        raise InputError("a pose graph without poses")
    ends, E = np.stack([graph.first, graph.second], axis=1), len(graph)
    shapes = (graph.T_first_second.shape, graph.information.shape, graph.is_loop.shape)
    if shapes != ((E, 4, 4), (E, 6, 6), (E,)):
        raise InputError(
            f"{E} edges, but shapes {shapes} of motions, information and is_loop", remedy="give one of each for every edge"
        )
    _check_rows("edge", ends, graph.poses)
    _check_rows("prior", graph.priors.pose[:, None], graph.poses)
    _refuse("edge", graph.first == graph.second, "joins a pose with itself", "leave it out")
    _check_values("edge", graph.T_first_second, graph.information)
    _check_values("prior", graph.priors.T_world_prior, graph.priors.information)
    _refuse("edge", negative(graph.information), "has information that is negative somewhere", "check the covariance")
    _refuse("prior", negative(graph.priors.information), "has information that is negative somewhere", "check the covariance")
    _check_connection(graph)


def negative(information: FloatArray) -> NDArray[np.bool_]:
    """(M,) whose information (M, 6, 6) is not positive semi-definite."""
    slack = ROUNDING * np.abs(information).max(axis=(1, 2), initial=np.finfo(float).tiny)
    loosened = information + slack[:, None, None] * np.eye(6)
    try:
        np.linalg.cholesky(loosened)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(loosened)[:, 0] <= 0.0)
    return np.zeros(len(information), np.bool_)


def _check_rows(what: str, rows: NDArray[np.int64], poses: int) -> None:
    outside = ((rows < 0) | (rows >= poses)).any(axis=1)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        raise InputError(f"names pose {rows[k].tolist()} of {poses}", record=f"{what} {k}", remedy="number the poses from 0")


def _check_values(what: str, T: FloatArray, information: FloatArray) -> None:
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(information).all(axis=(1, 2))
    _refuse(what, ~finite, "holds values that are not finite", "leave it out")
    R = T[:, :3, :3]
    off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
    _refuse(what, np.asarray((off > NOT_A_ROTATION) | (np.linalg.det(R) < 0.0)), "has a matrix that is no rotation", "normalise it")


def _refuse(what: str, bad: NDArray[np.bool_] | np.bool_, fault: str, remedy: str) -> None:
    if bad.any():
        k = np.flatnonzero(bad)
        raise InputError(f"{fault} ({len(k)} of {np.size(bad)} such)", record=f"{what} {k[0]}", remedy=remedy)


def _check_connection(graph: PoseGraph) -> None:
    joined = coo_matrix((np.ones(len(graph)), (graph.first, graph.second)), shape=(graph.poses, graph.poses))
    parts, part = connected_components(joined, directed=False)
    held = np.unique(part[graph.priors.pose]) if len(graph.priors.pose) else np.array([part[0]])
    loose = np.setdiff1d(np.arange(parts), held)
    if len(loose):
        poses = np.flatnonzero(part == loose[0])
        raise InputError(
            f"{parts} parts that no edge joins, {len(loose)} of them without a prior",
            record=f"pose {poses[0]} and {len(poses) - 1} more",
            remedy="solve the parts one by one, or give each a prior",
        )
