"""Drives through the city: where each vehicle goes, when, and what moves around it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wayloom.errors import ConfigError
from wayloom.simulation.city import City
from wayloom.simulation.paths import AVENUE_LANE_M, LANE_M, lane_path
from wayloom.simulation.routes import Route, driven_alone, line_of, nearest_s
from wayloom.simulation.traffic import Traffic, build_traffic

EGO_CLEARANCE_M = 4.5


@dataclass(frozen=True, slots=True)
class Way:
    """What a vehicle wants.

    nodes        crossings passed (row * columns + column), neighbours in the street graph
    start_s      s after the city's time zero
    closed       from the last node back to the first, and on to where it began
    reference    place in `nodes` of the crossing from which the start is measured
    before_m     the start lies this far before that crossing, m along the lane
    duration_s   of the drive; None for a closed way: once around
    fastest_m_s  speed on a free, straight street
    laps         of a closed way: poses repeat lap by lap; signals and traffic are ignored
    """

    nodes: tuple[int, ...]
    start_s: float = 0.0
    closed: bool = False
    reference: int = 0
    before_m: float = 30.0
    duration_s: float | None = None
    fastest_m_s: float = 12.5
    laps: bool = False


@dataclass(frozen=True, slots=True)
class Drive:
    """route: its motion; traffic: what moves around it; left_out: the movers that are this vehicle itself."""

    route: Route
    traffic: Traffic
    left_out: frozenset[int] = frozenset()


def plan_drives(city: City, ways: Sequence[Way]) -> list[Drive]:
    """One drive a way. Vehicles that drive at the same time share the same traffic and meet each other.

    Raises ConfigError where a way has no such streets, or ends before its time.
    """
    traffic = build_traffic(city, city.models)
    out = []
    for way in ways:
        route = _route(city, way)
        t = np.arange(route.start_s, route.end_s, 0.1)
        x, y = route.places(t).T
        out.append(Drive(route, traffic, traffic.meeting(x, y, t, EGO_CLEARANCE_M)))
    return out


def _route(city: City, way: Way) -> Route:
    graph = city.graph
    pairs = list(zip(way.nodes, (*way.nodes[1:], *(way.nodes[:1] if way.closed else ())), strict=False))
    avenue = all(graph.street(a, b).is_avenue for a, b in pairs)
    path = lane_path(graph.nodes[list(way.nodes)], AVENUE_LANE_M if avenue else LANE_M, closed=way.closed)
    start = nearest_s(path, graph.nodes[way.nodes[way.reference]]) - way.before_m
    duration = way.duration_s if way.duration_s is not None else path.length_m / way.fastest_m_s * 1.5
    line = line_of(path, way.closed)
    route = driven_alone(line, city.ground, start, way.start_s, duration, way.fastest_m_s)
    if not way.closed and (start < 0 or start + route.length_m > path.length_m - 1.0):
        what = f"the vehicle starts {start:.0f} m into a way of {path.length_m:.0f} m and drives off its end"
        raise ConfigError(what, remedy="pass more crossings, or drive fewer frames")
    return route
