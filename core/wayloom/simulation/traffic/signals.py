"""Traffic signal phases: the lit lamps as a function of place and time alone."""

from typing import Final

from wayloom.simulation.city.streets import Control, StreetGraph

GREEN_S, AMBER_S, ALL_RED_S, RED_AMBER_S = 10.0, 3.0, 1.5, 1.2
HALF_CYCLE_S: Final = GREEN_S + AMBER_S + ALL_RED_S
RED, AMBER, GREEN = range(3)
GOLDEN = 0.618034


def phase_s(graph: StreetGraph, node: int, origin: int, t_s: float) -> float:
    """Time since green began for traffic from `origin` to `node`, s; repeats after two half cycles."""
    row, column = divmod(node, graph.columns)
    offset = (0.55 + GOLDEN * (3 * row + 5 * column)) % 1.0 * 2 * HALF_CYCLE_S
    across = HALF_CYCLE_S if abs(origin - node) == 1 else 0.0
    return (t_s + offset + across) % (2 * HALF_CYCLE_S)


def lit(graph: StreetGraph, node: int, origin: int, t_s: float) -> tuple[int, ...]:
    """The lamps that are lit for traffic from `origin`."""
    phase = phase_s(graph, node, origin, t_s)
    if phase < GREEN_S:
        return (GREEN,)
    if phase < GREEN_S + AMBER_S:
        return (AMBER,)
    return (RED, AMBER) if phase > 2 * HALF_CYCLE_S - RED_AMBER_S else (RED,)


def is_open(graph: StreetGraph, node: int, origin: int, t_s: float, waited_s: float = 0.0, patience_s: float = 6.0) -> bool:
    """Whether traffic may enter: always where there are no signals; on amber only after waiting in the crossing."""
    if graph.control(node) is not Control.SIGNALS:
        return True
    phase = phase_s(graph, node, origin, t_s)
    return phase < GREEN_S or (phase < GREEN_S + AMBER_S and waited_s > patience_s)
