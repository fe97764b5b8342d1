"""Benchmark of the pose graph solver: public graphs to their known optima, false loops, growth with size."""

import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.evaluation.g2o_files import read_g2o
from wayloom.evaluation.made_graphs import city_drive, with_false_groups, with_false_loops
from wayloom.mapping.descent import place_at
from wayloom.mapping.pose_graph import optimise_pose_graph
from wayloom.mapping.pose_graph_equations import graph_equations
from wayloom.mapping.pose_graph_types import PoseGraph, PoseGraphSolution, SolverSettings

KNOWN_OPTIMA: Final = {
    "sphere2500": 675.701,
    "parking-garage": 0.634192,
    "city10000": 255.994,
    "manhattan": 1774.52,
    "kitti_00": 49.1611,
    "kitti_02": 39.3823,
    "torus3D": 12117.6,
    "cubicle": 1368.16,
}
"""Half of chi-square, by gtsam 4.3.0."""
FALSE_SHARE: Final = 0.1
SIZES: Final = ((1_000, 50), (3_000, 150), (10_000, 500), (30_000, 1_500), (100_000, 5_000))
PLAIN = SolverSettings(robust=False)


def solved(graph: PoseGraph, guess: np.ndarray | None, settings: SolverSettings) -> tuple[PoseGraphSolution, float]:
    """The solution, and processor time in seconds."""
    began = time.process_time()
    solution = optimise_pose_graph(graph, guess, settings)
    return solution, time.process_time() - began


def optima(files: list[Path]) -> Iterator[str]:
    """A row for each file: without a guess and from the file's."""
    yield (
        "| graph | poses, edges | optimum | off the known one | systems | s without a guess | s from the file's |\n"
        + "| --- " * 7
        + "|"
    )
    for path in files:
        file = read_g2o(path)
        solution, seconds = solved(file.graph, None, PLAIN)
        known = KNOWN_OPTIMA.get(path.stem)
        off = "–" if known is None else f"{solution.cost / known - 1.0:+.1e}"
        again = "–"
        if file.T_world_node is not None:
            other, more = solved(file.graph, file.T_world_node, PLAIN)
            again = f"{more:.2f}" if abs(other.cost / solution.cost - 1.0) < 1e-6 else f"{more:.2f}, cost {other.cost:.7g}"
        size = f"{file.graph.poses}, {len(file.graph)}"
        yield f"| {path.stem} | {size} | {solution.cost:.7g} | {off} | {solution.iterations} | {seconds:.2f} | {again} |"


def false_loops(files: list[Path], seed: int, group: int = 1) -> Iterator[str]:
    """A row for each file with a tenth of false loops added, alone or in groups that agree, judged by the clean graph."""
    head = "| graph | loops, false | false kept | right ones lost | clean cost there, off its optimum | poses off m | systems | s |"
    yield head + "\n" + "| --- " * 8 + "|"
    for path in files:
        graph = read_g2o(path).graph
        count = round(FALSE_SHARE * int(graph.is_loop.sum()))
        mixed = with_false_loops(graph, count, seed) if group == 1 else with_false_groups(graph, count, group, seed)
        clean, _ = solved(graph, None, PLAIN)
        solution, seconds = solved(mixed, None, SolverSettings())
        equations = graph_equations(graph)
        there = place_at(equations, equations.state(solution.T_world_node), np.ones(len(graph))).cost
        kept, lost = (solution.weight[len(graph) :] > 0.0).sum(), (solution.weight[: len(graph)] == 0.0).sum()
        moved = np.linalg.norm(solution.T_world_node[:, :3, 3] - clean.T_world_node[:, :3, 3], axis=1).max()
        false = len(mixed) - len(graph)
        off = f"{there / clean.cost - 1.0:+.1e} | {moved:.2g}"
        yield f"| {path.stem} | {graph.is_loop.sum()}, {false} | {kept} | {lost} | {off} | {solution.iterations} | {seconds:.1f} |"


def growth(seed: int) -> Iterator[str]:
    """A row for each size of a drive through a city, from its odometry."""
    yield "| poses | loops | systems | s | µs a pose | peak memory MB | largest error m: odometry | solved |\n" + "| --- " * 8 + "|"
    for poses, loops in SIZES:
        made = city_drive(poses, loops, seed)
        solution, seconds = solved(made.graph, made.T_world_odometry, SolverSettings())
        T_true = np.linalg.inv(made.T_world_true[0]) @ made.T_world_true
        worst = [
            np.linalg.norm(T[:, :3, 3] - T_true[:, :3, 3], axis=1).max() for T in (made.T_world_odometry, solution.T_world_node)
        ]
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        row = f"| {poses} | {made.graph.is_loop.sum()} | {solution.iterations} | {seconds:.2f} | {1e6 * seconds / poses:.0f} |"
        yield f"{row} {memory:.0f} | {worst[0]:.2f} | {worst[1]:.2f} |"
