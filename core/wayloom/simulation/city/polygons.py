"""Polygon outlines of roads, crossings, sidewalks and lawns."""

from collections.abc import Iterable

import numpy as np

from wayloom.simulation.city.blocks import LandUse, land_use, verges
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.ground import APRON_M, KERB_M, MOUND_M, ROAD, SIDEWALK, TERRAIN, island_rim, verge_ring
from wayloom.simulation.city.objects import TrueArea
from wayloom.simulation.city.streets import F64, ISLAND_M, BlockShape, StreetGraph
from wayloom.simulation.city.terrain import Terrain


def areas(settings: CitySettings, graph: StreetGraph, ground: Terrain, blocks: Iterable[int]) -> list[TrueArea]:
    """Outlines of streets, crossings, sidewalks and lawns of the given blocks: streets, then crossings, then block by block."""
    chosen = list(blocks)
    edges = sorted({(min(e), max(e)) for block in chosen for e in graph.shape(block).edges()})
    nodes = sorted({node for block in chosen for node in graph.loop(block)})
    out = [_street(graph, ground, a, b) for a, b in edges]
    for node in nodes:
        out += _junction(graph, ground, node)
    for block in chosen:
        out += _block(settings, graph, ground, block)
    return out


def _ring(ground: Terrain, xy: F64, above_m: float = 0.0, hole: bool = False) -> F64:
    """(N + 1, 3) closed: counter-clockwise, a hole clockwise."""
    x, y = xy[:, 0], xy[:, 1]
    if (float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0) == hole:
        xy = xy[::-1]
    xy = np.vstack([xy, xy[:1]])
    return np.column_stack([xy, ground.height(xy[:, 0], xy[:, 1]) + above_m])


def _street(graph: StreetGraph, ground: Terrain, a: int, b: int) -> TrueArea:
    """The carriageway between two crossings, zebras included; of an outermost street the half that a block has."""
    p, q = graph.nodes[a], graph.nodes[b]
    length, half = float(np.hypot(*(q - p))), graph.street(a, b).half_width_m
    d = (q - p) / length
    left = np.array([-d[1], d[0]]) * half
    p, q = p + d * graph.clear_m(a, b), q - d * graph.clear_m(b, a)
    sides = [1.0, -1.0]
    if graph.is_outer(a, b):
        middle = graph.shapes_beside(a, b)[0].middle.mean(axis=0)
        sides = [1.0, 0.0] if (middle - graph.nodes[a]) @ left > 0 else [0.0, -1.0]
    return TrueArea(
        ROAD, _ring(ground, np.array([p + left * sides[0], p + left * sides[1], q + left * sides[1], q + left * sides[0]]))
    )


def _junction(graph: StreetGraph, ground: Terrain, node: int) -> list[TrueArea]:
    """Outline of a crossing, with the island of a roundabout cut out of it and added beside it."""
    rim: list[F64] = []
    quarters = [graph.shape(block) for block in graph.blocks_at(node)]
    if len(quarters) == 2 and quarters[0].nodes.index(node) == 0 and quarters[1].nodes.index(node) == 3:
        quarters = quarters[::-1]  # at the western border the gap lies between them
    for shape in quarters:
        rim += _quarter(graph, shape, shape.nodes.index(node))
    if len(quarters) < 4:
        rim.append(graph.nodes[node])
    outline = np.array(rim)
    if len(quarters) < 4 or not quarters[0].roundabout[0]:
        return [TrueArea(ROAD, _ring(ground, outline))]

    def circle(radius_m: float) -> F64:
        return np.vstack([island_rim(graph.nodes[node], s, s.nodes.index(node), radius_m)[:-1] for s in quarters])

    rims = (circle(ISLAND_M), circle(ISLAND_M - APRON_M))
    return [
        TrueArea(ROAD, _ring(ground, outline), (_ring(ground, rims[0], hole=True),)),
        TrueArea(SIDEWALK, _ring(ground, rims[0], KERB_M), (_ring(ground, rims[1], KERB_M, hole=True),)),
        TrueArea(TERRAIN, _ring(ground, rims[1], KERB_M + MOUND_M)),
    ]


def _quarter(graph: StreetGraph, shape: BlockShape, k: int) -> list[F64]:
    """The rim of a crossing before a block's corner k, counter-clockwise around the node, from one street's middle to the next."""
    d_out, in_out, _ = shape.edge(k)
    d_in, in_in, _ = shape.edge(k - 1)
    node, here = shape.middle[k], shape.nodes[k]
    out = node + d_out * graph.clear_m(here, shape.nodes[(k + 1) % 4])
    back = node - d_in * graph.clear_m(here, shape.nodes[k - 1])
    return [out, out + in_out * shape.half_m[k], *shape.arcs[k][::-1], back + in_in * shape.half_m[k - 1], back]


def _block(settings: CitySettings, graph: StreetGraph, ground: Terrain, block: int) -> list[TrueArea]:
    """The sidewalk around a block, its lawn strips, and the ground behind it."""
    shape, square = graph.shape(block), land_use(settings, block) is LandUse.SQUARE
    strips = [np.array(verge_ring(shape, k)) for k, strip in enumerate(verges(settings, block)) if strip]
    holes = [_ring(ground, shape.inner, KERB_M, hole=True), *(_ring(ground, strip, KERB_M, hole=True) for strip in strips)]
    return [
        TrueArea(SIDEWALK, _ring(ground, shape.kerb_line(), KERB_M), tuple(holes)),
        *(TrueArea(TERRAIN, _ring(ground, strip, KERB_M)) for strip in strips),
        TrueArea(SIDEWALK if square else TERRAIN, _ring(ground, shape.inner, KERB_M)),
    ]
