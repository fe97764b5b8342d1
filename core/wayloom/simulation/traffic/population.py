"""Traffic population around the recording vehicles: vehicles enter and leave out of sight to keep the wanted density."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation.city.city import City
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.mesh import Mesh
from wayloom.simulation.models.vehicles import braking
from wayloom.simulation.traffic.car_following import STEP_S, Agent, TrafficSimulation
from wayloom.simulation.traffic.lanes import Element, Lane, LaneGraph
from wayloom.simulation.traffic.traffic import RecordedTraffic, Vehicle

REACH_M, OUT_OF_SIGHT_M = 250.0, 150.0
"""Streets within the first distance of a recording vehicle hold traffic; vehicles are inserted beyond the second."""
WARM_UP_S = 40.0
MEAN_SPACING_M = {Lane.CAR: 55.0, Lane.CYCLE: 80.0, Lane.TRAM: 190.0}
"""Mean distance between the fronts of two vehicles in a lane at traffic 1."""
LEAST_SPACING_M = {Lane.CAR: 17.0, Lane.CYCLE: 20.0, Lane.TRAM: 60.0}
"""Least distance between fronts when lanes are first filled."""
JAM_SPACING_M = {Lane.CAR: 13.0, Lane.CYCLE: 20.0, Lane.TRAM: 32.0}
DESIRED_SPEED_M_S = {Lane.CAR: (9.0, 13.0), Lane.CYCLE: (4.0, 5.5), Lane.TRAM: (8.0, 10.0)}
BUS_LORRY_BIKER_SHARES, TRAM_SHARE = (0.08, 0.09, 0.10), 0.6
"""Shares of buses, lorries and motorcycles in the lanes for cars; share of trams, against buses, on the rails."""
RUSH_HOUR_FACTOR = 0.3
"""Relative growth of the shares of buses and lorries for each unit of traffic above 1."""
EDGE_SHARE = 0.35
"""Weight of an exit that leaves the city, against one that stays in it."""
FULL_STREET_M = 15.0
BACKGROUND_S = 150.0
INSERT_EVERY = 5
"""Steps between two insertions of vehicles."""


@dataclass(slots=True)
class RecordingVehicle:
    """A recording vehicle: its agent, its start, its end (`done` of agent and time), and the number of steps that it drove."""

    agent: Agent
    start_s: float
    done: Callable[[Agent, float], bool]
    begun: bool = False
    steps: int | None = None


@dataclass(slots=True)
class TrafficPopulation:
    """Vehicles around the recording vehicles, inserted and removed to keep a density. All that ever were are kept."""

    city: City
    lanes: LaneGraph
    rng: np.random.Generator
    simulation: TrafficSimulation
    meshes: dict[int, Mesh] = field(default_factory=dict)
    all_agents: list[Agent] = field(default_factory=list)

    def new_agent(self, lane: Lane, element: Element, front_m: float, v_share: float) -> Agent:
        """A vehicle of random model and desired speed whose front is at front_m on a lane."""
        mesh = self._random_vehicle(lane)
        length = 2 * float(np.abs(mesh.corners[..., 0]).max())
        order = len(self.all_agents)
        desired = float(self.rng.uniform(*DESIRED_SPEED_M_S[lane]))
        agent = Agent(order, lane, length, desired, self.choose, [element], front_m, v_share * desired, self.simulation.t_s)
        self.meshes[order] = mesh
        self.all_agents.append(agent)
        return agent

    def fill(self, places: F64) -> None:
        """Insert vehicles on all lanes near places (P, 2) m, evenly spread."""
        for element in self._lanes_near(places, 0.0):
            lane, mean = element.key[0], self._mean_spacing(element.key[0])
            if not np.isfinite(mean):
                continue
            s = float(self.rng.uniform(0, mean)) + 6.0
            while s < element.length_m - 2.0:
                agent = self.new_agent(lane, element, s, 0.6)
                if agent.rear_m > 0.5:
                    self.simulation.enter(agent)
                s += max(min(LEAST_SPACING_M[lane], mean), float(self.rng.exponential(mean)), agent.length_m + 4.0)

    def insert_and_remove(self, places: F64) -> None:
        """Remove vehicles far from all places (P, 2) m; insert others, out of sight, where the density is too low."""
        for agent in self.simulation.agents:
            if np.hypot(*(places - agent.place()).T).min() > REACH_M + 60.0:
                agent.gone = True
        lanes = self._lanes_near(places, 0.0)
        entries = [e for e in self._lanes_near(places, OUT_OF_SIGHT_M) if e.length_m > 30] or lanes
        for lane in Lane:
            room = sum(e.length_m for e in lanes if e.key[0] is lane) / self._mean_spacing(lane)
            there = sum(agent.lane is lane for agent in self.simulation.agents)
            open_lanes = [e for e in entries if e.key[0] is lane]
            if not open_lanes or there >= room or self.rng.random() > 0.5:
                continue
            element = open_lanes[self.rng.integers(len(open_lanes))]
            agent = self.new_agent(lane, element, 0.0, 0.8)
            agent.front_m = agent.length_m + 0.5
            if self.simulation.is_free(element, 0.0, agent.front_m + 12.0):
                self.simulation.enter(agent)

    def _mean_spacing(self, lane: Lane) -> float:
        traffic = self.city.settings.traffic
        return max(MEAN_SPACING_M[lane] / traffic, JAM_SPACING_M[lane]) if traffic > 0 else np.inf

    def _lanes_near(self, places: F64, from_m: float) -> list[Element]:
        """Lanes whose middle is within REACH_M of a place and at least from_m from all; lanes into the city always pass."""
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
        """Random route choice at a crossing: mostly straight on, seldom out of the city; None at a dead end."""
        _, a, b, _ = agent.chain[-1].key
        if not exits:
            return None
        weights = np.array([self._weight(agent.lane, a, b, n) for n in exits])
        return exits[int(self.rng.choice(len(exits), p=weights / weights.sum()))]

    def _weight(self, lane: Lane, a: int, b: int, to: int) -> float:
        """Weight of an exit: 2 straight on, else 1; times EDGE_SHARE out of the city, times 0.05 into a full street."""
        full = self.simulation.room_m(self.lanes.along(lane, b, to)) < FULL_STREET_M
        return (2.0 if to - b == b - a else 1.0) * (EDGE_SHARE if self.city.graph.is_edge(to) else 1.0) * (0.05 if full else 1.0)

    def _random_vehicle(self, lane: Lane) -> Mesh:
        """The mesh of a random vehicle of a lane's kind."""
        models, rng, chance = self.city.models, self.rng, self.rng.random()
        if lane is Lane.CYCLE:
            return models.any_cyclist(rng)
        if lane is Lane.TRAM:
            return models.painted(models.tram if chance < TRAM_SHARE else models.bus, rng)
        rush = 1.0 + RUSH_HOUR_FACTOR * max(0.0, self.city.settings.traffic - 1.0)
        bus, lorry, biker = np.cumsum(np.array(BUS_LORRY_BIKER_SHARES) * (rush, rush, 1.0))
        if chance < bus:
            return models.painted(models.bus, rng)
        if chance < lorry:
            return models.painted(models.lorry, rng)
        return models.any_biker(rng) if chance < biker else models.any_car(rng)


def empty_population(city: City, t_s: float, key: int) -> TrafficPopulation:
    """A population without vehicles at a time; `key` selects its random stream among those of one city."""
    lanes = LaneGraph(city.graph)
    return TrafficPopulation(city, lanes, np.random.default_rng([city.seed, 5, key]), TrafficSimulation(lanes, t_s))


def run_traffic(population: TrafficPopulation, recording: list[RecordingVehicle], places: F64, until_s: float) -> float:
    """Simulate until all recording vehicles have ended, or, without any, until until_s; returns the time then.

    places  (P, 2) m around which the streets are filled before, and without recording vehicles all the time
    """
    population.fill(places)
    steps = 0
    while population.simulation.t_s < until_s and (not recording or any(w.steps is None for w in recording)):
        t = population.simulation.t_s
        for w in recording:
            if not w.begun and t >= w.start_s - 1e-9:
                w.begun = True
                population.simulation.clear_for(w.agent, 6.0, 14.0)
                w.agent.born_s = t
                population.simulation.enter(w.agent)
                population.simulation.limit_entry_speed(w.agent)
        if steps % INSERT_EVERY == 0:
            population.insert_and_remove(np.array([w.agent.place() for w in recording if w.steps is None and w.begun] or places))
        population.simulation.step()
        for w in recording:
            if w.begun and w.steps is None and (w.agent.gone or w.done(w.agent, population.simulation.t_s)):
                w.steps = len(w.agent.front_history_m)
                w.agent.choose, w.agent.keeps_route = population.choose, False
        steps += 1
    return population.simulation.t_s


def recorded_traffic(population: TrafficPopulation) -> RecordedTraffic:
    """The trajectories of all vehicles that ever moved."""
    out = []
    for agent in population.all_agents:
        if len(agent.front_history_m) > 1:
            s, xy = agent.polyline()
            mesh, front_m = population.meshes[agent.order], np.array(agent.front_history_m)
            out.append(Vehicle(agent.order, mesh, braking(mesh), agent.length_m, s, xy, agent.born_s, STEP_S, front_m))
    return RecordedTraffic(out)


class BackgroundTraffic:
    """Traffic around a city's middle without recording vehicles: simulated when first asked for, repeated every BACKGROUND_S."""

    def __init__(self, city: City) -> None:
        self._city, self._lock = city, threading.Lock()
        self._known: RecordedTraffic | None = None

    def vehicles(self, t_s: float) -> list[Vehicle]:
        """The vehicles that are there at a time."""
        with self._lock:
            if self._known is None:
                self._known = self._simulated()
        return self._known.vehicles(t_s % BACKGROUND_S)

    def _simulated(self) -> RecordedTraffic:
        moving = empty_population(self._city, -WARM_UP_S, 0)
        run_traffic(moving, [], np.zeros((1, 2)), BACKGROUND_S + STEP_S)
        return recorded_traffic(moving)
