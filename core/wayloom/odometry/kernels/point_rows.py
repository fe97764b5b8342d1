"""Rows of the point table: chosen ones of it, and those of two tables behind each other. A call instead of one a column."""

import numpy as np

from wayloom.odometry.kernels.arrays import PointColumns
from wayloom.odometry.kernels.compiler import inlined, kernel


def empty_points(n, like):  # type: ignore[no-untyped-def]
    """PointColumns of n points that are not filled yet, with as many columns of `closed` as another."""
    return PointColumns(
        np.empty(n, np.int64), np.empty((n, 2)), np.empty(n), np.empty((n, 8), np.float32), np.empty((n, 8), np.float32),
        np.empty(n, np.int64), np.empty((n, like.closed.shape[1]), np.int64),
    )  # fmt: skip


@kernel
def take_points(points, rows, out):  # type: ignore[no-untyped-def]
    """The points in these rows (n,) into out (n)."""
    for row in range(rows.shape[0]):
        copy_point(points, rows[row], out, row)


@kernel
def join_points(first, second, out):  # type: ignore[no-untyped-def]
    """The points of both, in that order, into out."""
    n = first.host.shape[0]
    for row in range(n):
        copy_point(first, row, out, row)
    for row in range(second.host.shape[0]):
        copy_point(second, row, out, n + row)


@inlined
def copy_point(points, row, out, to):  # type: ignore[no-untyped-def]
    """A row of points into another one of out."""
    out.host[to], out.rho[to], out.has_static[to] = points.host[row], points.rho[row], points.has_static[row]
    out.uv[to, 0], out.uv[to, 1] = points.uv[row, 0], points.uv[row, 1]
    for k in range(out.colour.shape[1]):
        out.colour[to, k], out.weight[to, k] = points.colour[row, k], points.weight[row, k]
    for k in range(out.closed.shape[1]):
        out.closed[to, k] = points.closed[row, k]


@kernel
def forget_frame(host, closed, j):  # type: ignore[no-untyped-def]
    """Frame j leaves the window: those after it move up by one in host (N,) and closed (N, capacity)."""
    for i in range(host.shape[0]):
        if host[i] > j:
            host[i] -= 1
        for k in range(j, closed.shape[1] - 1):
            closed[i, k] = closed[i, k + 1]
        closed[i, closed.shape[1] - 1] = 0
