import numpy as np

from georeference.made_city_drives import SMALL_WAY, city_drive, closures_of
from georeference.made_gnss_drives import MadeDrive
from wayloom.georeference.closures import closure_links
from wayloom.georeference.first_guess import level_world
from wayloom.georeference.nodes import choose_nodes, odometry_chain
from wayloom.loops.types import LoopClosures
from wayloom.mapping.drive_types import DriveNoise
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.own_frame import LoopGraph, StartGauge
from wayloom.mapping.truncated_squares import HEARINGS, _heard
from wayloom.mapping.up_factors import nothing_of_up

NOISE = DriveNoise(0.005, np.radians(0.02), 0.002, np.radians(0.01), 0.002, 100.0, np.radians(3.0), 30.0, 0.02, 0.9999, 1e-6, 1e-6)
CONVERGED = 30
"""Iterations after which a descent is at its end."""


def graph_of(drive: MadeDrive, closures: LoopClosures) -> tuple[LoopGraph, np.ndarray]:
    """Without GNSS and gravity; and the first guess of all nodes."""
    trajectory = drive.odometry.trajectory
    nodes = choose_nodes(trajectory, drive.odometry.keyframes.frame, 0.5)
    chain = odometry_chain(trajectory, nodes, 500.0)
    evidence = Evidence(closure_links(closures, drive.odometry.keyframes, nodes, chain), nothing_of_up())
    T = level_world(chain.T_world_node) @ chain.T_world_node
    return LoopGraph(chain, StartGauge(T[0]), NOISE, evidence), T


class Counted(LoopGraph):
    """Counts its descents."""

    solves = 0

    def solve(self, weight, start, solves):
        self.solves += 1
        return super().solve(weight, start, solves)


def test_visits_that_the_odometry_denies_are_heard_by_one_descent_each():
    drive = city_drive([*SMALL_WAY[:-1], (0.0, 100.0)], seed=2, scale_sigma=0.002)
    graph, T = graph_of(drive, closures_of(drive, false=12))
    graph.__class__ = Counted
    false = graph.distance2(graph.equations(np.ones(len(graph.price))).first_state(T[graph.nodes])) > 1e3 * graph.price
    weight = np.where(false, 0.0, 1.0)
    state = graph.solve(weight, graph.equations(weight).first_state(T[graph.nodes]), CONVERGED)
    graph.solves = 0
    believed, _ = _heard(graph, weight, state)
    assert false.sum() == 4
    assert np.array_equal(believed, weight)
    assert graph.solves <= HEARINGS
