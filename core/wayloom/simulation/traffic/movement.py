"""Vehicles in the streets around one or more recording vehicles, moved step by step: they follow who is ahead, stop at red lights,
and enter a crossing only when nobody is in their way.

Following is the intelligent driver model (Treiber, Hennecke, Helbing, Congested traffic states in empirical observations and
microscopic simulations, 2000, eqs. 2 and 3). A crossing is entered on a grant: no vehicle that has one is still before or in the
part of its way that is too close to one's own. Ways are planned from crossing to crossing, at random or as a vehicle wants.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation.city.streets import F64
from wayloom.simulation.traffic import signals
from wayloom.simulation.traffic.lanes import ALONG, SLOW_DOWN_M_S2, Element, Key, Lane, LaneGraph

STEP_S = 0.2
PULL_M_S2, BRAKE_M_S2, HARDEST_M_S2 = 1.9, 2.0, 7.0
HEADWAY_S, STANDING_GAP_M = 1.2, 2.0
LOOK_AHEAD_M = 60.0
LINE_GAP_M = 0.4
"""How far before the line one stops."""
ASK_FROM_M = 4.0
CALM_M_S2 = 1.2
PATIENCE_S = 5.0
SPARE_S = 1.2
"""How long before another one one must be gone from his way."""
ROOM_M = 3.0
"""Free road behind a crossing, besides one's own length, that one must see before entering it."""
Chooser = Callable[["Agent", tuple[int, ...]], int | None]


@dataclass(slots=True, eq=False)
class Agent:
    """A vehicle on its chain of lanes and crossings, alternately, beginning with a lane.

    front_m, v_m_s  place of its front bumper from the start of the chain, and speed
    starts          where each element of the chain begins, m
    at, tail        elements in which its front and its rear are
    granted         the last element that it may enter
    patient         keeps to its way even if it is blocked
    way             its front at every step since born_s
    """

    order: int
    lane: Lane
    length_m: float
    wish_m_s: float
    choose: Chooser
    chain: list[Element]
    front_m: float
    v_m_s: float
    born_s: float
    starts: list[float] = field(default_factory=lambda: [0.0])
    at: int = 0
    tail: int = 0
    granted: int = 0
    patient: bool = False
    waited_s: float = 0.0
    gone: bool = False
    way: list[float] = field(default_factory=list)

    @property
    def rear_m(self) -> float:
        """Its rear bumper."""
        return self.front_m - self.length_m

    @property
    def to_line_m(self) -> float:
        """From the front to the end of its element."""
        return self.starts[self.at] + self.chain[self.at].length_m - self.front_m

    def add(self, element: Element) -> None:
        """Go on into one more element."""
        self.starts.append(self.starts[-1] + self.chain[-1].length_m)
        self.chain.append(element)

    def place(self) -> F64:
        """(2,) m of its front."""
        element, s = self.chain[self.at], self.front_m - self.starts[self.at]
        return np.array([np.interp(s, element.s, element.xy[:, k]) for k in (0, 1)])

    def polyline(self) -> tuple[F64, F64]:
        """s (N,) and xy (N, 2) of the whole chain so far."""
        s = [element.s[1:] + start for element, start in zip(self.chain, self.starts, strict=True)]
        xy = [element.xy[1:] for element in self.chain]
        return np.concatenate([[0.0], *s]), np.vstack([self.chain[0].xy[:1], *xy])


class Streets:
    """All vehicles of a part of the city at one time, and what they need to know of each other."""

    def __init__(self, lanes: LaneGraph, t_s: float) -> None:
        self.lanes, self.t_s = lanes, t_s
        self.agents: list[Agent] = []
        self._on: dict[Key, list[Agent]] = {}
        self._holders: dict[int, list[tuple[Agent, int]]] = {}

    def step(self) -> None:
        """Everybody STEP_S further."""
        self._look()
        self._grant()
        speeds = [self._next_speed(agent) for agent in self.agents]
        for agent, v in zip(self.agents, speeds, strict=True):
            agent.way.append(agent.front_m)
            agent.front_m += v * STEP_S
            agent.v_m_s = v
            agent.waited_s = agent.waited_s + STEP_S if v < 0.5 else 0.0
            self._advance(agent)
        self.t_s += STEP_S
        self.agents = [agent for agent in self.agents if not agent.gone]

    def enter(self, agent: Agent) -> None:
        """One more vehicle, whose chain holds its first lane at least."""
        agent.tail = agent.at = 0
        while agent.front_m > agent.starts[agent.at] + agent.chain[agent.at].length_m and not agent.gone:
            self._plan(agent)
            agent.at += 1
            agent.granted = max(agent.granted, agent.at)
            if agent.at % 2:
                self._hold(agent, agent.at)
        agent.granted += agent.granted % 2
        self.agents.append(agent)

    def settle(self, agent: Agent) -> None:
        """Slow a vehicle that has just entered to what suits the bend, the line or the vehicle ahead of it."""
        self._look()
        self._grant()
        gap, v_other = self._ahead(agent)
        room = max(0.0, gap - STANDING_GAP_M) if v_other is not None else gap
        agent.v_m_s = min(agent.v_m_s, self._wish(agent), ((v_other or 0.0) ** 2 + 2 * CALM_M_S2 * room) ** 0.5)

    def is_free(self, element: Element, from_m: float, to_m: float) -> bool:
        """Whether nobody is on that part of an element."""
        return not any(front > from_m and rear < to_m for front, rear, _ in self._places(element.key))

    def clear_for(self, new: Agent, behind_m: float, ahead_m: float) -> None:
        """Take away who is in the way of a vehicle that is about to begin."""
        here = new.place()

        def is_in_the_way(agent: Agent) -> bool:
            room_m = 0.5 * agent.length_m + (ahead_m if agent.lane is new.lane else behind_m)
            return not agent.patient and bool(np.hypot(*(agent.place() - here)) < room_m)

        self.agents = [agent for agent in self.agents if not is_in_the_way(agent)]
        kept = set(map(id, self.agents))
        self._holders = {node: [(a, k) for a, k in held if id(a) in kept] for node, held in self._holders.items()}

    def _look(self) -> None:
        """Note who is on which element."""
        self._on = {}
        for agent in self.agents:
            for element in agent.chain[agent.tail : agent.at + 1]:
                self._on.setdefault(element.key, []).append(agent)

    def _places(self, key: Key) -> Iterable[tuple[float, float, Agent]]:
        """Front, rear and vehicle of all on an element, m from its start."""
        for other in self._on.get(key, ()):
            for k in range(other.tail, other.at + 1):
                if other.chain[k].key == key:
                    yield other.front_m - other.starts[k], other.rear_m - other.starts[k], other

    def _plan(self, agent: Agent) -> None:
        """Have a crossing and the lane behind it ahead, if the way goes on."""
        if len(agent.chain) > agent.at + 2:
            return
        lane, a, b, _ = agent.chain[-1].key
        node = agent.choose(agent, self.lanes.exits(lane, a, b))
        if node is not None:
            agent.add(self.lanes.across(lane, a, b, node))
            agent.add(self.lanes.along(lane, b, node))

    def _advance(self, agent: Agent) -> None:
        """Note new elements under a vehicle; take it away at the end of its way."""
        while agent.front_m > agent.starts[agent.at] + agent.chain[agent.at].length_m:
            if agent.at + 1 == len(agent.chain):
                agent.gone = True
                return
            agent.at += 1
        while agent.rear_m > agent.starts[agent.tail] + agent.chain[agent.tail].length_m:
            if agent.tail % 2:
                self._release(agent, agent.tail)
            agent.tail += 1

    def _hold(self, agent: Agent, k: int) -> None:
        self._holders.setdefault(agent.chain[k].key[2], []).append((agent, k))

    def _release(self, agent: Agent, k: int) -> None:
        held = self._holders[agent.chain[k].key[2]]
        held[:] = [(other, j) for other, j in held if other is not agent or j != k]

    def _grant(self) -> None:
        """Let those enter their crossing who are near it and in nobody's way: straight on before turns, the nearest first."""
        asking = []
        for agent in self.agents:
            if agent.at % 2 or agent.granted > agent.at:
                continue
            self._plan(agent)
            gap = agent.to_line_m
            if len(agent.chain) > agent.at + 2 and gap < ASK_FROM_M + agent.v_m_s * (0.3 + agent.v_m_s / (2 * BRAKE_M_S2)):
                asking.append((self._is_left(agent.chain[agent.at + 1].key), gap, agent.order, agent))
        for *_, agent in sorted(asking, key=lambda ask: ask[:3]):
            if not self._is_first(agent) or not self._is_clear(agent):
                continue
            if not self._has_room(agent):
                self._think_again(agent)
            else:
                agent.granted = agent.at + 2
                self._hold(agent, agent.at + 1)

    def _is_first(self, agent: Agent) -> bool:
        """Whether nobody ahead in its lane still waits to be let in."""
        key, mine = agent.chain[agent.at].key, agent.front_m - agent.starts[agent.at]
        return not any(front > mine and other.at % 2 == 0 and other.granted <= other.at for front, _, other in self._places(key))

    def _is_left(self, key: Key) -> bool:
        """Whether a way across a crossing turns left."""
        nodes = self.lanes.graph.nodes
        a, b, c = (nodes[n] for n in key[1:])
        return bool((b - a)[0] * (c - b)[1] - (b - a)[1] * (c - b)[0] > 0.5 * np.hypot(*(b - a)) * np.hypot(*(c - b)))

    def _is_clear(self, agent: Agent) -> bool:
        """Whether the signal lets it go and nobody else is in its way across the crossing."""
        turn = agent.chain[agent.at + 1]
        _, origin, node, _ = turn.key
        if not signals.is_open(self.lanes.graph, node, origin, self.t_s, agent.waited_s):
            return False
        for other, k in self._holders.get(node, ()):
            their = other.chain[k]
            if their.key[:3] != turn.key[:3]:
                zone = self.lanes.conflict(their.key, turn.key)
                if zone is not None and other.rear_m - other.starts[k] < zone[1] and not self._is_before(agent, other, k, zone[0]):
                    return False
        return True

    def _is_before(self, agent: Agent, other: Agent, k: int, from_m: float) -> bool:
        """Whether it is past the common part of its and another's way well before the other comes there, from_m m on element k."""
        turn = agent.chain[agent.at + 1]
        zone = self.lanes.conflict(turn.key, other.chain[k].key)
        if zone is None:
            return False
        way, v, top = agent.to_line_m + zone[1] + agent.length_m, agent.v_m_s, min(agent.wish_m_s, float(turn.limit_m_s.min()))
        if self._ahead(agent, agent.at + 2)[0] < way + ROOM_M:
            return False
        mine = max(0.0, top - v) / PULL_M_S2 + max(0.0, way - max(0.0, top**2 - v**2) / (2 * PULL_M_S2)) / top
        theirs = (other.starts[k] + from_m - other.front_m) / max(other.v_m_s, other.wish_m_s)
        return mine + SPARE_S < theirs

    def _has_room(self, agent: Agent) -> bool:
        """Whether it need not stop in the crossing: behind it there is room, also for those who were let in before."""
        turn, exit_lane = agent.chain[agent.at + 1], agent.chain[agent.at + 2]
        holders = self._holders.get(turn.key[2], ())
        coming = sum(other.length_m + STANDING_GAP_M for other, k in holders if other.chain[k + 1].key == exit_lane.key)
        return self.room_m(exit_lane) - coming > min(agent.length_m + ROOM_M, exit_lane.length_m)

    def room_m(self, element: Element) -> float:
        """How much of a lane's beginning is free, or soon will be."""
        return min((rear + 1.5 * other.v_m_s for _, rear, other in self._places(element.key)), default=np.inf)

    def _think_again(self, agent: Agent) -> None:
        """Choose another way after a long wait before a full street, if there is a choice."""
        if agent.patient or agent.waited_s < PATIENCE_S:
            return
        agent.waited_s = 0.0
        del agent.chain[agent.at + 1 :], agent.starts[agent.at + 1 :]
        self._plan(agent)

    def _wish(self, agent: Agent) -> float:
        """How fast it wants to go on a free way: slowed by bends."""
        here, at = agent.chain[agent.at], agent.front_m - agent.starts[agent.at]
        if agent.at % 2:
            return min(agent.wish_m_s, float(np.interp(at, here.s, here.limit_m_s)))
        if len(agent.chain) > agent.at + 1:
            v2 = float(agent.chain[agent.at + 1].limit_m_s[0]) ** 2 + 2 * SLOW_DOWN_M_S2 * (here.length_m - at)
            return min(agent.wish_m_s, float(np.sqrt(v2)))
        return agent.wish_m_s

    def _next_speed(self, agent: Agent) -> float:
        """Speed after the next step: towards the wish, slowed by who is ahead and by the line at a closed crossing."""
        wish, v = self._wish(agent), agent.v_m_s
        gap, v_other = self._ahead(agent)
        closing = v - (v_other or 0.0)
        wanted = v * closing / (2 * (PULL_M_S2 * BRAKE_M_S2) ** 0.5)
        if v_other is not None:
            wanted = STANDING_GAP_M + max(0.0, v * HEADWAY_S + wanted)
        a = PULL_M_S2 * (1 - (v / max(wish, 0.1)) ** 4 - (wanted / max(gap, 0.05)) ** 2)
        return float(min(max(0.0, v + STEP_S * min(max(a, -HARDEST_M_S2), PULL_M_S2)), gap / STEP_S))

    def _ahead(self, agent: Agent, granted: int | None = None) -> tuple[float, float | None]:
        """Free way to who is ahead (m) and his speed, or to the line and None; LOOK_AHEAD_M where there is nobody."""
        for k in range(agent.at, len(agent.chain)):
            offset = agent.starts[k] - agent.front_m
            if offset > LOOK_AHEAD_M:
                break
            if k > (agent.granted if granted is None else granted):
                return max(0.0, offset - LINE_GAP_M), None
            best: tuple[float, float] | None = None
            for front, rear, other in self._near(agent.chain[k]):
                if (
                    other is not agent
                    and (front, other.order) > (-offset, agent.order)
                    and (best is None or offset + rear < best[0])
                ):
                    best = (offset + rear, other.v_m_s)
            if best is not None:
                return max(0.0, best[0]), best[1]
        return LOOK_AHEAD_M * 4, None

    def _near(self, element: Element) -> Iterable[tuple[float, float, Agent]]:
        """Who is on an element, or on another way from the same lane that has not yet parted from it."""
        yield from self._places(element.key)
        lane, a, b, onto = element.key
        if onto != ALONG:
            for c in self.lanes.exits(lane, a, b):
                other = (lane, a, b, c)
                if other != element.key and other in self._on:
                    zone = self.lanes.conflict(other, element.key)
                    for front, rear, agent in self._places(other):
                        if zone is not None and rear < zone[1]:
                            yield front, rear, agent
