"""Made pose graphs with exact truth: a sphere, a lattice, drives through a city's grid of streets, and false loops."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.pose_graph_types import PoseGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MadeGraph:
    """A graph, where its poses are, (N, 4, 4), and the odometry chained up."""

    graph: PoseGraph
    T_world_true: FloatArray
    T_world_odometry: FloatArray


def measured_graph(T_world_true: FloatArray, pairs: IntArray, sigma_m: float, sigma_rad: float, seed: int) -> MadeGraph:
    """Odometry between neighbouring poses (N, 4, 4) and loops at pairs (L, 2), with white noise of these sigmas on each axis."""
    rng = np.random.default_rng(seed)
    n = len(T_world_true)
    first, second = np.concatenate([np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), pairs]).T
    sigma = np.repeat([sigma_m, sigma_rad], 3)
    noise = se3.exp(rng.normal(size=(len(first), 6)) * sigma)
    T = noise @ se3.inverse(T_world_true[first]) @ T_world_true[second]
    information = np.tile(np.diag(sigma**-2), (len(first), 1, 1))
    graph = PoseGraph(n, first, second, T, information, np.arange(len(first)) >= n - 1)
    return MadeGraph(graph, T_world_true, chained(T[: n - 1]))


def chained(steps: FloatArray) -> FloatArray:
    """(N, 4, 4) from the identity by steps (N - 1, 4, 4)."""
    T = np.empty((len(steps) + 1, 4, 4))
    T[0] = np.eye(4)
    for k, step in enumerate(steps):
        T[k + 1] = T[k] @ step
    return T


def sphere(rings: int, around: int, sigma_m: float, sigma_rad: float, seed: int) -> MadeGraph:
    """A way in rings over a sphere of 50 m, looking along it, with loops to the ring before."""
    k = np.arange(rings * around)
    up, turn = np.pi * ((k / around) / rings - 0.5) * 0.9, 2.0 * np.pi * k / around
    position = 50.0 * np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=1)
    ahead = np.stack([-np.sin(turn), np.cos(turn), np.zeros(len(k))], axis=1)
    outward = position / 50.0
    R = np.stack([ahead, np.cross(outward, ahead), outward], axis=2)
    pairs = np.stack([k[:-around], k[around:]], axis=1)
    return measured_graph(se3.from_rotation_translation(R, position), pairs, sigma_m, sigma_rad, seed)


def lattice(side: int, share: float, sigma_m: float, sigma_rad: float, seed: int) -> MadeGraph:
    """A way to and fro through a cube of side^3 places 1 m apart, turned at random; loops to a share of the other neighbours."""
    rng = np.random.default_rng(seed)
    i, j, k = np.unravel_index(np.arange(side**3), (side, side, side))
    j = np.where(i % 2 == 0, j, side - 1 - j)
    k = np.where((i * side + j) % 2 == 0, k, side - 1 - k)
    place = np.stack([i, j, k], axis=1)
    row = {tuple(p): r for r, p in enumerate(place.tolist())}
    pairs = [(r, row[q]) for r, p in enumerate(place.tolist()) for q in _neighbours(p) if abs(row.get(q, r) - r) > 1]
    loops = np.unique(np.sort(np.array(pairs), axis=1), axis=0)
    loops = loops[rng.random(len(loops)) < share]
    T = se3.exp(np.concatenate([np.zeros((side**3, 3)), rng.normal(size=(side**3, 3))], axis=1))
    T[:, :3, 3] = place
    return measured_graph(T, loops, sigma_m, sigma_rad, seed)


def _neighbours(place: list[int]) -> list[tuple[int, ...]]:
    return [tuple(c + (axis == a) * step for a, c in enumerate(place)) for axis in range(3) for step in (-1, 1)]


def city_drive(poses: int, loops: int, seed: int, block_m: float = 100.0, step_m: float = 2.0) -> MadeGraph:
    """A drive through a grid of streets that turns at random at crossings, and never around; loops where it comes again, at random.

    The camera looks ahead, conventions of the left camera (x right, y down, z forward), the world is up in z. The
    odometry is off by 1 cm and
    0.03 degrees a keyframe, loops by 10 cm and 0.2 degrees.
    """
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(poses * step_m / block_m / 4.0))) + 2
    at, heading = np.array([side // 2, side // 2]), np.array([1, 0])
    per_block = int(block_m / step_m)
    position: list[FloatArray] = []
    ahead: list[IntArray] = []
    while len(position) * per_block < poses + per_block:
        turns = [
            t for t in (heading, heading[::-1] * [1, -1], heading[::-1] * [-1, 1]) if (at + t >= 0).all() and (at + t < side).all()
        ]
        heading = turns[rng.integers(len(turns))]
        position.append(block_m * at + step_m * np.arange(per_block)[:, None] * heading)
        ahead.append(np.tile(heading, (per_block, 1)))
        at = at + heading
    xy, forward = np.concatenate(position)[:poses], np.concatenate(ahead)[:poses].astype(np.float64)
    R = np.zeros((poses, 3, 3))
    R[:, 0, 0], R[:, 1, 0] = forward[:, 1], -forward[:, 0]
    R[:, 2, 1] = -1.0
    R[:, :2, 2] = forward
    T = se3.from_rotation_translation(R, np.concatenate([xy, np.zeros((poses, 1))], axis=1))
    made = measured_graph(T, _revisits(xy, forward, loops, rng), 0.01, np.radians(0.03), seed)
    graph = made.graph
    information = graph.information.copy()
    information[graph.is_loop] = np.diag(np.repeat([0.1, np.radians(0.2)], 3) ** -2.0)
    noise = se3.exp(rng.normal(size=(int(graph.is_loop.sum()), 6)) * np.repeat([0.1, np.radians(0.2)], 3))
    T_loop = graph.T_first_second.copy()
    true = se3.inverse(T[graph.first]) @ T[graph.second]
    T_loop[graph.is_loop] = noise @ true[graph.is_loop]
    return replace(made, graph=replace(graph, T_first_second=T_loop, information=information))


def _revisits(xy: FloatArray, forward: FloatArray, loops: int, rng: np.random.Generator) -> IntArray:
    """(L, 2) poses at one place and of one heading, the earlier first."""
    code = np.round(xy[:, 0]) * 4_000_003.0 + np.round(xy[:, 1]) * 11.0 + forward[:, 0] * 3.0 + forward[:, 1]
    order = np.argsort(code, kind="stable")
    same = np.flatnonzero(np.diff(code[order]) == 0.0)
    chosen = rng.permutation(same)[:loops]
    return np.stack([order[chosen], order[chosen + 1]], axis=1)


def with_false_loops(graph: PoseGraph, count: int, seed: int) -> PoseGraph:
    """The graph and `count` loops more, between random poses, with random steps as long as the graph's loops and as
    sure as them.
    """
    rng = np.random.default_rng(seed)
    first = rng.integers(0, graph.poses, count)
    second = (first + rng.integers(2, graph.poses - 1, count)) % graph.poses
    twin = rng.choice(np.flatnonzero(graph.is_loop), count)
    xi = np.concatenate(
        [np.zeros((count, 3)), rng.uniform(-np.pi, np.pi, (count, 3)) * ([0, 0, 1] if graph.planar else [1, 1, 1])], axis=1
    )
    T = se3.exp(xi)
    length = np.linalg.norm(graph.T_first_second[twin, :3, 3], axis=1)
    direction = rng.normal(size=(count, 3)) * ([1, 1, 0] if graph.planar else [1, 1, 1])
    T[:, :3, 3] = (length + rng.exponential(1.0, count))[:, None] * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(
        graph,
        first=np.concatenate([graph.first, first]),
        second=np.concatenate([graph.second, second]),
        T_first_second=np.concatenate([graph.T_first_second, T]),
        information=np.concatenate([graph.information, graph.information[twin]]),
        is_loop=np.concatenate([graph.is_loop, np.ones(count, np.bool_)]),
    )


def with_false_groups(graph: PoseGraph, count: int, size: int, seed: int) -> PoseGraph:
    """The graph and about `count` false loops more, in groups of `size` that agree with each other, as look-alike streets give.

    Each group joins two stretches of the drive, pose by pose, by one random step as long as the graph's loops.
    """
    rng = np.random.default_rng(seed)
    groups, m = max(1, round(count / size)), np.arange(size)
    step, told = _odometry(graph)
    starts = np.flatnonzero(np.convolve(~told, np.ones(size - 1, np.int64), mode="valid") == 0)  # of unbroken stretches
    seeds = with_false_loops(graph, groups, seed)
    first, second, T = [], [], []
    for k in range(len(graph), len(graph) + groups):
        i, j = rng.choice(starts, 2, replace=False)
        first.append(i + m)
        second.append(j + m)
        T.append(se3.inverse(chained(step[i : i + size - 1])) @ seeds.T_first_second[k] @ chained(step[j : j + size - 1]))
    information = np.repeat(seeds.information[len(graph) :], size, axis=0)
    noise = se3.exp(_drawn(information, rng))
    return replace(
        graph,
        first=np.concatenate([graph.first, *first]),
        second=np.concatenate([graph.second, *second]),
        T_first_second=np.concatenate([graph.T_first_second, noise @ np.concatenate(T)]),
        information=np.concatenate([graph.information, information]),
        is_loop=np.concatenate([graph.is_loop, np.ones(groups * size, np.bool_)]),
    )


def _odometry(graph: PoseGraph) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Trusted steps (N - 1, 4, 4) from each pose to the next, and whether there is one (N - 1,)."""
    rows = np.flatnonzero(~graph.is_loop & (graph.second == graph.first + 1))
    step, told = np.tile(np.eye(4), (graph.poses - 1, 1, 1)), np.zeros(graph.poses - 1, np.bool_)
    step[graph.first[rows]], told[graph.first[rows]] = graph.T_first_second[rows], True
    return step, told


def _drawn(information: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(E, 6) of noise with information (E, 6, 6); none in directions of which it tells nothing."""
    value, axes = np.linalg.eigh(information)
    told = value > 1e-9 * value[:, -1:]
    sigma = np.where(told, 1.0 / np.sqrt(np.where(told, value, 1.0)), 0.0)
    return np.asarray((axes @ (sigma * rng.normal(size=value.shape))[:, :, None])[:, :, 0])
