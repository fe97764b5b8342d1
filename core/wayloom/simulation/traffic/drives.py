"""Drive planning: the recording vehicles' paths through the city, run together in one traffic simulation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wayloom.errors import ConfigError
from wayloom.simulation.city.city import City
from wayloom.simulation.city.instance_ids import vehicle_number
from wayloom.simulation.traffic.car_following import STEP_S, Agent
from wayloom.simulation.traffic.lanes import Element, Lane, LaneGraph
from wayloom.simulation.traffic.population import (
    WARM_UP_S,
    RecordingVehicle,
    TrafficPopulation,
    empty_population,
    recorded_traffic,
    run_traffic,
)
from wayloom.simulation.traffic.routes import MARGIN_S, Route, eased, lap_route, line_through, timed
from wayloom.simulation.traffic.traffic import Traffic

FRONT_M, LENGTH_M = 2.1, 4.6
"""Of a recording vehicle: its front bumper before its body's origin, and its length."""
FIRST_SPEED = 0.9
SLOWEST_M_S = 0.6
"""A drive around that is slower than this on the whole is given up."""
ESTIMATED_M_S = 2.5
CLASH_S, CLASH_M = 30.0, 40.0
"""Two vehicles that begin nearer to each other than this, in time and place, are kept apart."""
BEYOND_S = 2.0
"""How long a recording vehicle is followed after its end."""
SAMPLES_BEYOND = int(np.ceil(MARGIN_S / STEP_S)) + 8


@dataclass(frozen=True, slots=True)
class RoutePlan:
    """Route and schedule wanted for a recording vehicle.

    nodes        crossings passed (row * columns + column), neighbours in the street graph
    start_s      s after the city's time zero
    closed       from the last node back to the first, and on to where it began
    reference    place in `nodes` of the crossing from which the start is measured
    before_m     the start lies this far before that crossing, m along the lane, or at the beginning of the route's first lane
    duration_s   of the drive; None for a closed route: once around
    fastest_m_s  speed on a free, straight street
    laps         of a closed route: poses repeat lap by lap; signals and others are ignored
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
    """route: its motion; traffic: what moves around it; left_out: the instance numbers of this vehicle itself."""

    route: Route
    traffic: Traffic
    left_out: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class _LanePath:
    """A route as lanes. s (N,), xy (N, 2): the line; start_m: where on it the vehicle begins; around_m: once around, if closed."""

    nodes: tuple[int, ...]
    s: np.ndarray
    xy: np.ndarray
    start_m: float
    around_m: float


def plan_drives(city: City, plans: Sequence[RoutePlan]) -> list[Drive]:
    """One drive for each plan, in the order given. Vehicles that drive at the same time share one traffic simulation and meet each
    other, but for those that begin at one place: each is then in traffic of its own.

    They keep to the lanes, stop at red lights and follow who is ahead. Equal arguments give equal drives.
    Raises ConfigError where a plan has no such streets, ends before its time, or leads into streets that are full for good.
    """
    lanes = LaneGraph(city.graph)
    paths = [_lane_path(lanes, plan) for plan in plans]
    drives: dict[int, Drive] = {}
    for group in _groups(plans, paths):
        drives |= zip(group, _simulate_group(city, [plans[k] for k in group], [paths[k] for k in group]), strict=True)
    return [drives[k] for k in range(len(plans))]


def _groups(plans: Sequence[RoutePlan], paths: Sequence[_LanePath]) -> list[list[int]]:
    """Indices of the plans that share a traffic simulation: they overlap in time and do not begin at one place."""
    groups: list[tuple[list[int], float]] = []
    begin = [path.xy[np.searchsorted(path.s, path.start_m)] for path in paths]
    for k in sorted(range(len(plans)), key=lambda k: (plans[k].start_s, k)):
        end = plans[k].start_s + _estimated_s(plans[k], paths[k])
        for g, (members, until) in enumerate(groups):
            apart = all(
                plans[k].start_s - plans[j].start_s > CLASH_S or np.hypot(*(begin[k] - begin[j])) > CLASH_M for j in members
            )
            if plans[k].start_s <= until and apart:
                groups[g] = ([*members, k], max(end, until))
                break
        else:
            groups.append(([k], end))
    return [members for members, _ in groups]


def _estimated_s(plan: RoutePlan, path: _LanePath) -> float:
    return plan.duration_s if plan.duration_s is not None else path.around_m / ESTIMATED_M_S


def _lane_path(lanes: LaneGraph, plan: RoutePlan) -> _LanePath:
    """The lanes of a route. Those of a closed one go around and on over its start."""
    if len(plan.nodes) < (3 if plan.closed else 2):
        raise ConfigError(f"{len(plan.nodes)} crossings make no way", remedy="name more of them")
    before = plan.nodes[plan.reference :] + plan.nodes[: plan.reference] if plan.closed else plan.nodes
    nodes = (before[-1], *before, *before, before[0]) if plan.closed else before
    chain = [lanes.along(Lane.CAR, nodes[0], nodes[1])]
    starts = [0.0]
    for a, b, c in zip(nodes, nodes[1:], nodes[2:], strict=False):
        for element in (lanes.across(Lane.CAR, a, b, c), lanes.along(Lane.CAR, b, c)):
            starts.append(starts[-1] + chain[-1].length_m)
            chain.append(element)
    s = np.concatenate([[0.0], *(e.s[1:] + start for e, start in zip(chain, starts, strict=True))])
    xy = np.vstack([chain[0].xy[:1], *(e.xy[1:] for e in chain)])
    around = starts[2 * len(plan.nodes)] if plan.closed else np.inf
    reference = 1 if plan.closed else plan.reference
    return _LanePath(nodes, s, xy, max(0.0, _nearest_m(chain, starts, reference, lanes) - plan.before_m), float(around))


def _nearest_m(chain: list[Element], starts: list[float], reference: int, lanes: LaneGraph) -> float:
    """Arc length of the point of a chain nearest to the crossing before its lane number `reference`; 0 for lane number 0."""
    if reference == 0:
        return 0.0
    k = min(2 * reference - 1, len(chain) - 1)
    turn, node = chain[k], lanes.graph.nodes[chain[k].key[2]]
    return starts[k] + float(turn.s[np.argmin(np.linalg.norm(turn.xy - node, axis=1))])


def _simulate_group(city: City, plans: list[RoutePlan], paths: list[_LanePath]) -> list[Drive]:
    """Drives of one traffic simulation, which may meet each other."""
    population = empty_population(city, plans[0].start_s - WARM_UP_S, int(plans[0].start_s * 10))
    begun = [_recording_vehicle(population, plan, path) for plan, path in zip(plans, paths, strict=True) if not plan.laps]
    latest = max(w.start_s + (w.duration_s or 60.0 + path.around_m / SLOWEST_M_S) for w, path in zip(plans, paths, strict=True))
    run_traffic(population, begun, np.array([path.xy[np.searchsorted(path.s, path.start_m)] for path in paths]), latest + 10.0)
    traffic, recording = Traffic(city, recorded_traffic(population)), iter(begun)
    out = []
    for plan, path in zip(plans, paths, strict=True):
        if plan.laps:
            line = line_through(path.s, path.xy, path.around_m)
            out.append(Drive(lap_route(line, city.ground, path.start_m, plan.start_s, plan.fastest_m_s), traffic))
            continue
        vehicle = next(recording)
        driven = np.array(vehicle.agent.front_history_m[: vehicle.steps])
        out.append(
            Drive(_route(city, plan, path, vehicle.agent.born_s, driven), traffic, frozenset({vehicle_number(vehicle.agent.order)}))
        )
    return out


def _recording_vehicle(population: TrafficPopulation, plan: RoutePlan, path: _LanePath) -> RecordingVehicle:
    """The recording vehicle of a plan, which keeps to its route, and its end condition."""
    ahead = iter(path.nodes[2:])
    chain = [population.lanes.along(Lane.CAR, path.nodes[0], path.nodes[1])]
    agent = population.new_agent(Lane.CAR, chain[0], path.start_m + FRONT_M, 1.0)
    agent.choose, agent.keeps_route = lambda _agent, _exits: next(ahead, None), True
    agent.length_m, agent.desired_speed_m_s = LENGTH_M, plan.fastest_m_s
    population.meshes[agent.order] = population.city.models.any_car(population.rng)
    agent.v_m_s = FIRST_SPEED * plan.fastest_m_s

    def done(agent: Agent, t_s: float) -> bool:
        if plan.duration_s is not None:
            return t_s > plan.start_s + plan.duration_s + BEYOND_S
        return agent.front_m - FRONT_M > path.start_m + path.around_m + BEYOND_S * agent.v_m_s + 1.0

    return RecordingVehicle(agent, plan.start_s, done)


def _route(city: City, plan: RoutePlan, path: _LanePath, born_s: float, driven: np.ndarray) -> Route:
    """The motion of a recording vehicle from where its front was at each step from born_s on, `driven` (K,) m."""
    before, after = np.arange(-SAMPLES_BEYOND, 0), np.arange(1, SAMPLES_BEYOND + 1)
    front = np.concatenate([driven[0] + (driven[1] - driven[0]) * before, driven, driven[-1] + (driven[-1] - driven[-2]) * after])
    t = np.asarray(born_s + STEP_S * np.arange(-SAMPLES_BEYOND, len(driven) + SAMPLES_BEYOND), np.float64)
    smooth = eased(front - FRONT_M)
    end = plan.start_s + plan.duration_s if plan.duration_s is not None else _lap_end_s(t, smooth, path)
    if end + MARGIN_S > born_s + STEP_S * len(driven):
        what = (
            f"a way of {path.s[-1] - path.start_m:.0f} m, of which {driven[-1] - driven[0]:.0f} m were driven, drives off its end"
        )
        raise ConfigError(what, remedy="pass more crossings, drive fewer frames, or ask for less traffic")
    return Route(line_through(path.s, path.xy), timed(t, smooth), city.ground, plan.start_s, float(end))


def _lap_end_s(t: np.ndarray, arc_m: np.ndarray, path: _LanePath) -> float:
    """Time at which it is once around, rounded up to a tenth of a second; infinite if never."""
    passed = np.nonzero(arc_m >= path.start_m + path.around_m)[0]
    return float(np.ceil(t[passed[0]] * 10 - 1e-6) / 10) if len(passed) else np.inf
