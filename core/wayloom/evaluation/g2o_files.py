"""Pose graphs as g2o text files."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import read_text
from wayloom.geometry import se3
from wayloom.mapping.pose_graph_equations import spatial_of
from wayloom.mapping.pose_graph_types import PLANAR_ROWS, PoseGraph

FloatArray = NDArray[np.float64]
VERTICES: Final = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
EDGES: Final = {"EDGE_SE2": 9, "EDGE_SE3:QUAT": 28}


@dataclass(frozen=True, slots=True)
class GraphFile:
    """A pose graph as a file has it; vertices without an edge are left out.

    T_world_node (N, 4, 4) the file's guess, or None where it lacks any; number (N,) the file's number of each pose
    skipped      how many records of kinds that are not read; indefinite: edges whose information had to be mended
    """

    graph: PoseGraph
    T_world_node: FloatArray | None
    number: NDArray[np.int64]
    skipped: dict[str, int] = field(default_factory=dict)
    indefinite: int = 0


def read_g2o(file: Path) -> GraphFile:
    """Edges and vertices in SE(2) or SE(3). An edge between consecutive numbers is odometry, another one a loop.

    The information of an edge is taken as gtsam takes it: of the error seen from the second pose, order (v, omega),
    omega in radians.
    Raises InputError, which names the line.
    """
    numbers: dict[str, list[list[int]]] = {kind: [] for kind in (*VERTICES, *EDGES)}
    values: dict[str, list[list[float]]] = {kind: [] for kind in numbers}
    skipped: dict[str, int] = {}
    for k, line in enumerate(_lines(file), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        kind, ids = words[0], 2 if words[0] in EDGES else 1
        if kind not in numbers:
            skipped[kind] = skipped.get(kind, 0) + 1
            continue
        if len(words) != 1 + ids + (EDGES | VERTICES)[kind]:
            raise InputError(f"{kind} has {len(words) - 1} numbers", file=file, record=f"line {k}", remedy=_expected(kind, ids))
        try:
            numbers[kind].append([int(word) for word in words[1 : 1 + ids]])
            values[kind].append([float(word) for word in words[1 + ids :]])
        except ValueError as error:
            raise InputError(str(error), file=file, record=f"line {k}", remedy="mend the line") from error
    planar, spatial = (bool(numbers[kind]) for kind in EDGES)
    if planar == spatial:
        what = "edges in SE2 and in SE3 are mixed" if planar else f"no edges; other records: {sorted(skipped)}"
        raise InputError(what, file=file, remedy=f"give edges of one kind: {' or '.join(EDGES)}")
    kinds = ("VERTEX_SE2", "EDGE_SE2") if planar else ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT")
    vertex, edge = (np.array(numbers[kind]) for kind in kinds)
    place, step = (np.array(values[kind]) for kind in kinds)
    return _graph_file(vertex, place, edge, step, planar, skipped)


def _lines(file: Path) -> list[str]:
    return read_text(file, remedy="give a g2o file", error=InputError).splitlines()


def _expected(kind: str, ids: int) -> str:
    return f"{ids + (EDGES | VERTICES)[kind]} are expected"


def _graph_file(
    vertex: NDArray[np.int64],
    place: FloatArray,
    edge: NDArray[np.int64],
    step: FloatArray,
    planar: bool,
    skipped: dict[str, int],
) -> GraphFile:
    number = np.unique(edge)
    first, second = np.searchsorted(number, edge).T
    size, pose_of = (3, spatial_of) if planar else (7, _pose_of_quaternion)
    T = pose_of(step[:, :size])
    Ad = se3.adjoint(se3.inverse(T))
    right = _information(step[:, size:], planar)
    right, indefinite = (right, 0) if planar else as_gtsam_reads(right)
    information = np.swapaxes(Ad, 1, 2) @ right @ Ad
    is_loop = np.abs(edge[:, 0] - edge[:, 1]) != 1
    graph = PoseGraph(len(number), first, second, T, information, is_loop, planar=planar)
    guess = None
    if len(vertex) and np.isin(number, vertex).all():
        row = np.argsort(vertex[:, 0])[np.searchsorted(np.sort(vertex[:, 0]), number)]
        guess = pose_of(place[row])
    return GraphFile(graph, guess, number, skipped, indefinite)


def _information(upper: FloatArray, planar: bool) -> FloatArray:
    """(E, 6, 6) of the upper triangles in rows."""
    d = 3 if planar else 6
    small = np.zeros((len(upper), d, d))
    row, column = np.triu_indices(d)
    small[:, row, column] = small[:, column, row] = upper
    if not planar:
        return small
    out = np.zeros((len(upper), 6, 6))
    out[:, np.array(PLANAR_ROWS)[:, None], PLANAR_ROWS] = small
    return out


def _pose_of_quaternion(values: FloatArray) -> FloatArray:
    """x y z qx qy qz qw (..., 7) to (..., 4, 4)."""
    return se3.from_quaternion_wxyz(values[..., [6, 3, 4, 5]], values[..., :3])


def as_gtsam_reads(information: FloatArray) -> tuple[FloatArray, int]:
    """Positive semi-definite information (E, 6, 6), and how many matrices were not.

    Some published graphs (cubicle) have indefinite matrices. gtsam factors them by Eigen, in the order (omega, v),
    which stops at the
    first bad pivot and leaves the columns from there on as they stand; R^T R of that is what its costs, and the
    published optima, are of.
    """
    order = [3, 4, 5, 0, 1, 2]
    out, bad = information.copy(), 0
    for k in np.flatnonzero(np.linalg.eigvalsh(information)[:, 0] <= 0.0):
        L = np.tril(information[k][np.ix_(order, order)])
        for j in range(6):
            pivot = L[j, j] - L[j, :j] @ L[j, :j]
            if pivot <= 0.0:
                bad += 1
                break
            L[j, j] = np.sqrt(pivot)
            L[j + 1 :, j] = (L[j + 1 :, j] - L[j + 1 :, :j] @ L[j, :j]) / L[j, j]
        out[k][np.ix_(order, order)] = L @ L.T
    return out, bad


def write_g2o(file: Path, graph: PoseGraph, T_world_node: FloatArray) -> None:
    """A graph in space with poses (N, 4, 4), numbered by row; priors are left out. Raises InputError for graphs in the plane."""
    if graph.planar:
        raise InputError("graphs in the plane are not written", file=file, remedy="lift the graph into space")
    Ad = se3.adjoint(graph.T_first_second)
    right = np.swapaxes(Ad, 1, 2) @ graph.information @ Ad
    row, column = np.triu_indices(6)
    steps = np.column_stack([_values(graph.T_first_second), right[:, row, column]])
    lines = [f"VERTEX_SE3:QUAT {k} {_numbers(v)}" for k, v in enumerate(_values(T_world_node))]
    ends = zip(graph.first.tolist(), graph.second.tolist(), steps, strict=True)
    lines += [f"EDGE_SE3:QUAT {i} {j} {_numbers(v)}" for i, j, v in ends]
    write_atomically(file, ("\n".join(lines) + "\n").encode())


def _values(T: FloatArray) -> FloatArray:
    """x y z qx qy qz qw (..., 7)."""
    return np.concatenate([T[:, :3, 3], se3.quaternion_wxyz(T)[:, [1, 2, 3, 0]]], axis=1)


def _numbers(values: FloatArray) -> str:
    return " ".join(repr(value) for value in values.tolist())
