"""Traffic population around the recording vehicles: vehicles enter and leave out of sight to keep the wanted density."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation.city.city import City
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.mesh import Mesh
from wayloom.simulation.models.vehicles import braking
from wayloom.simulation.traffic.lanes import Element, Lane, LaneGraph
from wayloom.simulation.traffic.movement import STEP_S, Agent, Streets
from wayloom.simulation.traffic.traffic import Recorded, Vehicle

REACH_M, OUT_OF_SIGHT_M = 250.0, 150.0
"""Streets this near to a recording vehicle are filled; others come in farther away than the second."""
WARM_UP_S = 40.0
GAP_M = {Lane.CAR: 55.0, Lane.CYCLE: 80.0, Lane.TRAM: 190.0}
"""Mean distance of two vehicles in a lane on a usual day."""
SPREAD_M = {Lane.CAR: 17.0, Lane.CYCLE: 20.0, Lane.TRAM: 60.0}
"""Least distance at the beginning, where there is room."""
DENSEST_M = {Lane.CAR: 13.0, Lane.CYCLE: 20.0, Lane.TRAM: 32.0}
WISH_M_S = {Lane.CAR: (9.0, 13.0), Lane.CYCLE: (4.0, 5.5), Lane.TRAM: (8.0, 10.0)}
BUS_LORRY_BIKER_SHARES, TRAM_SHARE = (0.08, 0.09, 0.10), 0.6
"""How many of those in the lanes for all are buses, lorries and motorcycles; how many on the rails are trams, not buses."""
LARGER_IN_A_RUSH = 0.3
"""How much larger the shares of buses and lorries are for each usual day's traffic more."""
EDGE_SHARE = 0.35
"""How often one leaves the city where one could stay."""
FULL_M = 15.0
BACKGROUND_S = 150.0
BRING_EVERY = 5
"""Steps between two looks at how many are missing."""


@dataclass(slots=True)
class Wanted:
    """A recording vehicle: its agent, from start_s on until `done` says so, after so many steps."""

    agent: Agent
    start_s: float
    done: Callable[[Agent, float], bool]
    begun: bool = False
    steps: int | None = None


@dataclass(slots=True)
class Crowd:
    """Vehicles come and go; all that ever were are kept with their ways."""

    city: City
    lanes: LaneGraph
    rng: np.random.Generator
    streets: Streets
    looks: dict[int, Mesh] = field(default_factory=dict)
    everybody: list[Agent] = field(default_factory=list)

    def new_agent(self, lane: Lane, element: Element, front_m: float, v_share: float) -> Agent:
        """A random vehicle whose front is at front_m on a lane."""
        mesh = self._look_of(lane)
        length = 2 * float(np.abs(mesh.corners[..., 0]).max())
        order = len(self.everybody)
        wish = float(self.rng.uniform(*WISH_M_S[lane]))
        agent = Agent(order, lane, length, wish, self.choose, [element], front_m, v_share * wish, self.streets.t_s)
        self.looks[order] = mesh
        self.everybody.append(agent)
        return agent

    def fill(self, places: F64) -> None:
        """Vehicles on all lanes near places (P, 2) m, evenly spread."""
        for element in self._lanes_near(places, 0.0):
            lane, mean = element.key[0], self._mean_gap(element.key[0])
            if not np.isfinite(mean):
                continue
            s = float(self.rng.uniform(0, mean)) + 6.0
            while s < element.length_m - 2.0:
                agent = self.new_agent(lane, element, s, 0.6)
                if agent.rear_m > 0.5:
                    self.streets.enter(agent)
                s += max(min(SPREAD_M[lane], mean), float(self.rng.exponential(mean)), agent.length_m + 4.0)

    def renew(self, places: F64) -> None:
        """Take away who is far from all places (P, 2) m, and let others in out of sight where vehicles are missing."""
        for agent in self.streets.agents:
            if np.hypot(*(places - agent.place()).T).min() > REACH_M + 60.0:
                agent.gone = True
        lanes = self._lanes_near(places, 0.0)
        entries = [e for e in self._lanes_near(places, OUT_OF_SIGHT_M) if e.length_m > 30] or lanes
        for lane in Lane:
            room = sum(e.length_m for e in lanes if e.key[0] is lane) / self._mean_gap(lane)
            there = sum(agent.lane is lane for agent in self.streets.agents)
            open_lanes = [e for e in entries if e.key[0] is lane]
            if not open_lanes or there >= room or self.rng.random() > 0.5:
                continue
            element = open_lanes[self.rng.integers(len(open_lanes))]
            agent = self.new_agent(lane, element, 0.0, 0.8)
            agent.front_m = agent.length_m + 0.5
            if self.streets.is_free(element, 0.0, agent.front_m + 12.0):
                self.streets.enter(agent)

    def _mean_gap(self, lane: Lane) -> float:
        traffic = self.city.settings.traffic
        return max(GAP_M[lane] / traffic, DENSEST_M[lane]) if traffic > 0 else np.inf

    def _lanes_near(self, places: F64, from_m: float) -> list[Element]:
        """Lanes whose middle lies within REACH_M of a place and no nearer than from_m to any; those into the city count as far."""
        graph, out = self.city.graph, []
        for a in self._nodes_near(places):
            for b in graph.neighbours(a):
                middle = 0.5 * (graph.nodes[a] + graph.nodes[b])
                gap = np.hypot(*(places - middle).T).min()
                if graph.is_outer(a, b) or gap > REACH_M or (gap < from_m and not graph.is_edge(a)):
                    continue
                avenue = graph.street(a, b).is_avenue
                for lane in (Lane.CAR, Lane.TRAM if avenue else Lane.CYCLE):
                    out.append(self.lanes.along(lane, a, b))
        return out

    def _nodes_near(self, places: F64) -> list[int]:
        near = np.zeros(len(self.city.graph.nodes), bool)
        for place in places:
            near |= np.hypot(*(self.city.graph.nodes - place).T) < REACH_M + 60.0
        return [int(n) for n in np.nonzero(near)[0]]

    def choose(self, agent: Agent, exits: tuple[int, ...]) -> int | None:
        """Where to go on: mostly straight, seldom out of the city."""
        _, a, b, _ = agent.chain[-1].key
        if not exits:
            return None
        weights = np.array([self._weight(agent.lane, a, b, n) for n in exits])
        return exits[int(self.rng.choice(len(exits), p=weights / weights.sum()))]

    def _weight(self, lane: Lane, a: int, b: int, to: int) -> float:
        """How much one likes to go on to a node: straight on rather than not, into a full street hardly, seldom out of the city."""
        full = self.streets.room_m(self.lanes.along(lane, b, to)) < FULL_M
        return (2.0 if to - b == b - a else 1.0) * (EDGE_SHARE if self.city.graph.is_edge(to) else 1.0) * (0.05 if full else 1.0)

    def _look_of(self, lane: Lane) -> Mesh:
        """A random vehicle."""
        models, rng, chance = self.city.models, self.rng, self.rng.random()
        if lane is Lane.CYCLE:
            return models.any_cyclist(rng)
        if lane is Lane.TRAM:
            return models.painted(models.tram if chance < TRAM_SHARE else models.bus, rng)
        rush = 1.0 + LARGER_IN_A_RUSH * max(0.0, self.city.settings.traffic - 1.0)
        bus, lorry, biker = np.cumsum(np.array(BUS_LORRY_BIKER_SHARES) * (rush, rush, 1.0))
        if chance < bus:
            return models.painted(models.bus, rng)
        if chance < lorry:
            return models.painted(models.lorry, rng)
        return models.any_biker(rng) if chance < biker else models.any_car(rng)


def crowd(city: City, t_s: float, key: int) -> Crowd:
    """Empty streets at a time; `key` tells different crowds of one city apart."""
    lanes = LaneGraph(city.graph)
    return Crowd(city, lanes, np.random.default_rng([city.seed, 5, key]), Streets(lanes, t_s))


def run(crowd: Crowd, wanted: list[Wanted], places: F64, until_s: float) -> float:
    """Move everybody until all recording vehicles have ended, or, without any, until until_s; returns the time then.

    places  (P, 2) m around which the streets are filled before, and without recording vehicles all the time
    """
    crowd.fill(places)
    steps = 0
    while crowd.streets.t_s < until_s and (not wanted or any(w.steps is None for w in wanted)):
        t = crowd.streets.t_s
        for w in wanted:
            if not w.begun and t >= w.start_s - 1e-9:
                w.begun = True
                crowd.streets.clear_for(w.agent, 6.0, 14.0)
                w.agent.born_s = t
                crowd.streets.enter(w.agent)
                crowd.streets.settle(w.agent)
        if steps % BRING_EVERY == 0:
            crowd.renew(np.array([w.agent.place() for w in wanted if w.steps is None and w.begun] or places))
        crowd.streets.step()
        for w in wanted:
            if w.begun and w.steps is None and (w.agent.gone or w.done(w.agent, crowd.streets.t_s)):
                w.steps = len(w.agent.way)
                w.agent.choose, w.agent.patient = crowd.choose, False
        steps += 1
    return crowd.streets.t_s


def recorded(crowd: Crowd) -> Recorded:
    """All that ever moved in a crowd."""
    out = []
    for agent in crowd.everybody:
        if len(agent.way) > 1:
            s, xy = agent.polyline()
            mesh, way = crowd.looks[agent.order], np.array(agent.way)
            out.append(Vehicle(agent.order, mesh, braking(mesh), agent.length_m, s, xy, agent.born_s, STEP_S, way))
    return Recorded(out)


class Background:
    """The traffic around a city's middle when nobody drives: simulated when first asked for, repeated every BACKGROUND_S."""

    def __init__(self, city: City) -> None:
        self._city, self._lock = city, threading.Lock()
        self._known: Recorded | None = None

    def vehicles(self, t_s: float) -> list[Vehicle]:
        """All that are there."""
        with self._lock:
            if self._known is None:
                self._known = self._simulated()
        return self._known.vehicles(t_s % BACKGROUND_S)

    def _simulated(self) -> Recorded:
        moving = crowd(self._city, -WARM_UP_S, 0)
        run(moving, [], np.zeros((1, 2)), BACKGROUND_S + STEP_S)
        return recorded(moving)
