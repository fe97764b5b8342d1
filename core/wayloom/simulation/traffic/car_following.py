"""Car-following traffic along lanes (intelligent driver model), with signals and crossing reservations.

Following is the intelligent driver model (Treiber, Hennecke, Helbing, Congested traffic states in empirical observations and
microscopic simulations, 2000, eqs. 2 and 3). A crossing is entered only with a reservation, which is granted when no vehicle that
holds one is still before or in the part of its path that conflicts with one's own. Routes are planned from crossing to crossing, at
random or as a recording vehicle is told.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation.city.streets import F64
from wayloom.simulation.traffic import signals
from wayloom.simulation.traffic.lanes import ALONG, SLOW_DOWN_M_S2, Element, Key, Lane, LaneGraph

STEP_S = 0.2
ACCELERATION_M_S2, BRAKING_M_S2, HARDEST_BRAKING_M_S2 = 1.9, 2.0, 7.0
HEADWAY_S, MINIMUM_GAP_M = 1.2, 2.0
LOOK_AHEAD_M = 60.0
STOP_LINE_GAP_M = 0.4
"""Distance before the stop line at which a vehicle stops."""
REQUEST_FROM_M = 4.0
CALM_M_S2 = 1.2
PATIENCE_S = 5.0
CLEARANCE_S = 1.2
"""Time by which a vehicle must have left a conflict zone before another one enters it."""
EXIT_ROOM_M = 3.0
"""Free road behind a crossing, besides a vehicle's own length, that it needs before entering the crossing."""
RouteChoice = Callable[["Agent", tuple[int, ...]], int | None]


@dataclass(slots=True, eq=False)
class Agent:
    """A vehicle on its chain of lanes and crossings, alternately, beginning with a lane.

    front_m, v_m_s   place of its front bumper from the start of the chain, and speed
    starts           where each element of the chain begins, m
    at, tail         elements in which its front and its rear are
    granted          the last element that it may enter
    keeps_route      whether it never chooses another exit, even if it is blocked
    front_history_m  its front at every step since born_s
    """

    order: int
    lane: Lane
    length_m: float
    desired_speed_m_s: float
    choose: RouteChoice
    chain: list[Element]
    front_m: float
    v_m_s: float
    born_s: float
    starts: list[float] = field(default_factory=lambda: [0.0])
    at: int = 0
    tail: int = 0
    granted: int = 0
    keeps_route: bool = False
    waited_s: float = 0.0
    gone: bool = False
    front_history_m: list[float] = field(default_factory=list)

    @property
    def rear_m(self) -> float:
        """Position of its rear bumper, m."""
        return self.front_m - self.length_m

    @property
    def to_line_m(self) -> float:
        """Distance from its front to the end of its element, m."""
        return self.starts[self.at] + self.chain[self.at].length_m - self.front_m

    def add(self, element: Element) -> None:
        """Append an element to its chain."""
        self.starts.append(self.starts[-1] + self.chain[-1].length_m)
        self.chain.append(element)

    def place(self) -> F64:
        """(2,) position of its front, m."""
        element, s = self.chain[self.at], self.front_m - self.starts[self.at]
        return np.array([np.interp(s, element.s, element.xy[:, k]) for k in (0, 1)])

    def polyline(self) -> tuple[F64, F64]:
        """s (N,) and xy (N, 2) of the whole chain so far, m."""
        s = [element.s[1:] + start for element, start in zip(self.chain, self.starts, strict=True)]
        xy = [element.xy[1:] for element in self.chain]
        return np.concatenate([[0.0], *s]), np.vstack([self.chain[0].xy[:1], *xy])


class TrafficSimulation:
    """State of all vehicles of a part of the city: positions, lane occupancy, crossing reservations."""

    def __init__(self, lanes: LaneGraph, t_s: float) -> None:
        self.lanes, self.t_s = lanes, t_s
        self.agents: list[Agent] = []
        self._occupants: dict[Key, list[Agent]] = {}
        self._reservations: dict[int, list[tuple[Agent, int]]] = {}

    def step(self) -> None:
        """Advance all vehicles by STEP_S."""
        self._index_occupancy()
        self._grant_crossings()
        speeds = [self._next_speed(agent) for agent in self.agents]
        for agent, v in zip(self.agents, speeds, strict=True):
            agent.front_history_m.append(agent.front_m)
            agent.front_m += v * STEP_S
            agent.v_m_s = v
            agent.waited_s = agent.waited_s + STEP_S if v < 0.5 else 0.0
            self._advance(agent)
        self.t_s += STEP_S
        self.agents = [agent for agent in self.agents if not agent.gone]

    def enter(self, agent: Agent) -> None:
        """Insert a vehicle whose chain holds its first lane at least."""
        agent.tail = agent.at = 0
        while agent.front_m > agent.starts[agent.at] + agent.chain[agent.at].length_m and not agent.gone:
            self._extend_route(agent)
            agent.at += 1
            agent.granted = max(agent.granted, agent.at)
            if agent.at % 2:
                self._reserve(agent, agent.at)
        agent.granted += agent.granted % 2
        self.agents.append(agent)

    def limit_entry_speed(self, agent: Agent) -> None:
        """Lower the speed of a vehicle that has just entered to what the bend, the stop line or its leader allows."""
        self._index_occupancy()
        self._grant_crossings()
        gap, v_other = self._leader(agent)
        room = max(0.0, gap - MINIMUM_GAP_M) if v_other is not None else gap
        agent.v_m_s = min(agent.v_m_s, self._desired_speed(agent), ((v_other or 0.0) ** 2 + 2 * CALM_M_S2 * room) ** 0.5)

    def is_free(self, element: Element, from_m: float, to_m: float) -> bool:
        """Whether no vehicle is on that part of an element."""
        return not any(front > from_m and rear < to_m for front, rear, _ in self._occupants_of(element.key))

    def clear_for(self, new: Agent, behind_m: float, ahead_m: float) -> None:
        """Remove vehicles in the way of a recording vehicle that is about to begin."""
        here = new.place()

        def is_in_the_way(agent: Agent) -> bool:
            room_m = 0.5 * agent.length_m + (ahead_m if agent.lane is new.lane else behind_m)
            return not agent.keeps_route and bool(np.hypot(*(agent.place() - here)) < room_m)

        self.agents = [agent for agent in self.agents if not is_in_the_way(agent)]
        kept = set(map(id, self.agents))
        self._reservations = {node: [(a, k) for a, k in held if id(a) in kept] for node, held in self._reservations.items()}

    def _index_occupancy(self) -> None:
        """Index which vehicles are on which element."""
        self._occupants = {}
        for agent in self.agents:
            for element in agent.chain[agent.tail : agent.at + 1]:
                self._occupants.setdefault(element.key, []).append(agent)

    def _occupants_of(self, key: Key) -> Iterable[tuple[float, float, Agent]]:
        """Front and rear, m from the element's start, and vehicle, of all on an element."""
        for other in self._occupants.get(key, ()):
            for k in range(other.tail, other.at + 1):
                if other.chain[k].key == key:
                    yield other.front_m - other.starts[k], other.rear_m - other.starts[k], other

    def _extend_route(self, agent: Agent) -> None:
        """Append the next crossing and the lane behind it to a vehicle's chain, unless its route ends."""
        if len(agent.chain) > agent.at + 2:
            return
        lane, a, b, _ = agent.chain[-1].key
        node = agent.choose(agent, self.lanes.exits(lane, a, b))
        if node is not None:
            agent.add(self.lanes.across(lane, a, b, node))
            agent.add(self.lanes.along(lane, b, node))

    def _advance(self, agent: Agent) -> None:
        """Update the elements under a vehicle; release crossings behind it; mark it gone at the end of its chain."""
        while agent.front_m > agent.starts[agent.at] + agent.chain[agent.at].length_m:
            if agent.at + 1 == len(agent.chain):
                agent.gone = True
                return
            agent.at += 1
        while agent.rear_m > agent.starts[agent.tail] + agent.chain[agent.tail].length_m:
            if agent.tail % 2:
                self._release(agent, agent.tail)
            agent.tail += 1

    def _reserve(self, agent: Agent, k: int) -> None:
        self._reservations.setdefault(agent.chain[k].key[2], []).append((agent, k))

    def _release(self, agent: Agent, k: int) -> None:
        held = self._reservations[agent.chain[k].key[2]]
        held[:] = [(other, j) for other, j in held if other is not agent or j != k]

    def _grant_crossings(self) -> None:
        """Grant reservations of crossings: straight on before left turns, the nearest first."""
        asking = []
        for agent in self.agents:
            if agent.at % 2 or agent.granted > agent.at:
                continue
            self._extend_route(agent)
            gap = agent.to_line_m
            if len(agent.chain) > agent.at + 2 and gap < REQUEST_FROM_M + agent.v_m_s * (0.3 + agent.v_m_s / (2 * BRAKING_M_S2)):
                asking.append((self._is_left(agent.chain[agent.at + 1].key), gap, agent.order, agent))
        for *_, agent in sorted(asking, key=lambda ask: ask[:3]):
            if not self._is_first_in_lane(agent) or not self._crossing_is_clear(agent):
                continue
            if not self._has_room(agent):
                self._reroute(agent)
            else:
                agent.granted = agent.at + 2
                self._reserve(agent, agent.at + 1)

    def _is_first_in_lane(self, agent: Agent) -> bool:
        """Whether no vehicle ahead in its lane still waits for its reservation."""
        key, mine = agent.chain[agent.at].key, agent.front_m - agent.starts[agent.at]
        return not any(
            front > mine and other.at % 2 == 0 and other.granted <= other.at for front, _, other in self._occupants_of(key)
        )

    def _is_left(self, key: Key) -> bool:
        """Whether a path across a crossing turns left."""
        nodes = self.lanes.graph.nodes
        a, b, c = (nodes[n] for n in key[1:])
        return bool((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0] > 0.5 * np.hypot(*(b - a)) * np.hypot(*(c - b)))

    def _crossing_is_clear(self, agent: Agent) -> bool:
        """Whether the signal is open and no holder of a reservation conflicts with its path across the crossing."""
        turn = agent.chain[agent.at + 1]
        _, origin, node, _ = turn.key
        if not signals.is_open(self.lanes.graph, node, origin, self.t_s, agent.waited_s):
            return False
        for other, k in self._reservations.get(node, ()):
            their = other.chain[k]
            if their.key[:3] != turn.key[:3]:
                zone = self.lanes.conflict(their.key, turn.key)
                if (
                    zone is not None
                    and other.rear_m - other.starts[k] < zone[1]
                    and not self._clears_before(agent, other, k, zone[0])
                ):
                    return False
        return True

    def _clears_before(self, agent: Agent, other: Agent, k: int, from_m: float) -> bool:
        """Whether it leaves the conflict zone CLEARANCE_S before the other one, on its element k, reaches it at from_m."""
        turn = agent.chain[agent.at + 1]
        zone = self.lanes.conflict(turn.key, other.chain[k].key)
        if zone is None:
            return False
        distance_m, v = agent.to_line_m + zone[1] + agent.length_m, agent.v_m_s
        top = min(agent.desired_speed_m_s, float(turn.limit_m_s.min()))
        if self._leader(agent, agent.at + 2)[0] < distance_m + EXIT_ROOM_M:
            return False
        mine = (
            max(0.0, top - v) / ACCELERATION_M_S2 + max(0.0, distance_m - max(0.0, top**2 - v**2) / (2 * ACCELERATION_M_S2)) / top
        )
        theirs = (other.starts[k] + from_m - other.front_m) / max(other.v_m_s, other.desired_speed_m_s)
        return mine + CLEARANCE_S < theirs

    def _has_room(self, agent: Agent) -> bool:
        """Whether the lane behind the crossing has room for it and for those with earlier reservations."""
        turn, exit_lane = agent.chain[agent.at + 1], agent.chain[agent.at + 2]
        reservations = self._reservations.get(turn.key[2], ())
        coming = sum(other.length_m + MINIMUM_GAP_M for other, k in reservations if other.chain[k + 1].key == exit_lane.key)
        return self.room_m(exit_lane) - coming > min(agent.length_m + EXIT_ROOM_M, exit_lane.length_m)

    def room_m(self, element: Element) -> float:
        """Length of a lane's beginning that is free, or will be within 1.5 s."""
        return min((rear + 1.5 * other.v_m_s for _, rear, other in self._occupants_of(element.key)), default=np.inf)

    def _reroute(self, agent: Agent) -> None:
        """Choose another exit after a long wait before a full street."""
        if agent.keeps_route or agent.waited_s < PATIENCE_S:
            return
        agent.waited_s = 0.0
        del agent.chain[agent.at + 1 :], agent.starts[agent.at + 1 :]
        self._extend_route(agent)

    def _desired_speed(self, agent: Agent) -> float:
        """Desired speed on a free road, limited by the bend here or ahead."""
        here, at = agent.chain[agent.at], agent.front_m - agent.starts[agent.at]
        if agent.at % 2:
            return min(agent.desired_speed_m_s, float(np.interp(at, here.s, here.limit_m_s)))
        if len(agent.chain) > agent.at + 1:
            v2 = float(agent.chain[agent.at + 1].limit_m_s[0]) ** 2 + 2 * SLOW_DOWN_M_S2 * (here.length_m - at)
            return min(agent.desired_speed_m_s, float(np.sqrt(v2)))
        return agent.desired_speed_m_s

    def _next_speed(self, agent: Agent) -> float:
        """Speed after the next step, by the intelligent driver model; a closed crossing is a standing leader."""
        desired, v = self._desired_speed(agent), agent.v_m_s
        gap, v_other = self._leader(agent)
        closing = v - (v_other or 0.0)
        wanted = v * closing / (2 * (ACCELERATION_M_S2 * BRAKING_M_S2) ** 0.5)
        if v_other is not None:
            wanted = MINIMUM_GAP_M + max(0.0, v * HEADWAY_S + wanted)
        a = ACCELERATION_M_S2 * (1 - (v / max(desired, 0.1)) ** 4 - (wanted / max(gap, 0.05)) ** 2)
        return float(min(max(0.0, v + STEP_S * min(max(a, -HARDEST_BRAKING_M_S2), ACCELERATION_M_S2)), gap / STEP_S))

    def _leader(self, agent: Agent, granted: int | None = None) -> tuple[float, float | None]:
        """Gap to the leader (m) and its speed; to the stop line and None; far and None where there is neither."""
        for k in range(agent.at, len(agent.chain)):
            offset = agent.starts[k] - agent.front_m
            if offset > LOOK_AHEAD_M:
                break
            if k > (agent.granted if granted is None else granted):
                return max(0.0, offset - STOP_LINE_GAP_M), None
            best: tuple[float, float] | None = None
            for front, rear, other in self._occupants_near(agent.chain[k]):
                if (
                    other is not agent
                    and (front, other.order) > (-offset, agent.order)
                    and (best is None or offset + rear < best[0])
                ):
                    best = (offset + rear, other.v_m_s)
            if best is not None:
                return max(0.0, best[0]), best[1]
        return LOOK_AHEAD_M * 4, None

    def _occupants_near(self, element: Element) -> Iterable[tuple[float, float, Agent]]:
        """Vehicles on an element, or on another path from the same lane that has not yet diverged from it."""
        yield from self._occupants_of(element.key)
        lane, a, b, onto = element.key
        if onto != ALONG:
            for c in self.lanes.exits(lane, a, b):
                other = (lane, a, b, c)
                if other != element.key and other in self._occupants:
                    zone = self.lanes.conflict(other, element.key)
                    for front, rear, agent in self._occupants_of(other):
                        if zone is not None and rear < zone[1]:
                            yield front, rear, agent
