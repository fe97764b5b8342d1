"""Ground surfaces of a block: road, crossings, kerbs, sidewalks and lawns, over a flat plane (the city adds the terrain)."""

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.streets import AVENUE_HALF_M, CROSSING_LENGTH_M, F64, ISLAND_M, STREET_HALF_M, BlockShape
from wayloom.simulation.models.mesh import MeshBuilder
from wayloom.simulation.models.solids import at_height, grid_between
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.paint_ground import ASPHALT_TILE_M, AVENUE_TILE_M, STREET_TILE_M

ROAD, SIDEWALK, TERRAIN = CLASS_ID["road"], CLASS_ID["sidewalk"], CLASS_ID["terrain"]
KERB_M = 0.12
PIECE_M = 3.0
PAVER_TILE_M, LAWN_TILE_M, CONCRETE_TILE_M = 3.0, 4.0, 4.0
VERGE_M = (0.3, 1.5)
"""A lawn strip within the sidewalk: from the kerb, m."""
UNDERLAY_M = -0.35
YARD_PIECE_M = 6.0
ISLAND_STEPS, APRON_M, MOUND_M = 8, 0.9, 0.45


def _strip(m: MeshBuilder, shape: BlockShape, k: int, along: tuple[float, float], material: Material, tile_m: float) -> None:
    """Road from the street's middle to the kerb, from along[0] to along[1] m; u across from the left edge of the tile, v along."""
    d, inward, _ = shape.edge(k)
    node, half = shape.middle[k], shape.half_m[k]
    a, b = node + d * along[0], node + d * along[1]
    quads = grid_between(a, b, b + inward * half, a + inward * half, PIECE_M)
    across, forward = (quads - node) @ inward, (quads - node) @ d
    m.quads(at_height(quads, 0.0), np.stack([across / tile_m + 0.5, forward / tile_m], -1), material, ROAD)


def half_street(m: MeshBuilder, shape: BlockShape, k: int, clear: tuple[float, float]) -> None:
    """This block's half of street k: crossing, marked road, crossing."""
    _, _, length = shape.edge(k)
    a, b = clear[0], length - clear[1]
    avenue = shape.half_m[k] == AVENUE_HALF_M
    material, tile = (Material.AVENUE, AVENUE_TILE_M) if avenue else (Material.STREET, STREET_TILE_M)
    _strip(m, shape, k, (a, a + CROSSING_LENGTH_M), Material.CROSSING, ASPHALT_TILE_M)
    _strip(m, shape, k, (a + CROSSING_LENGTH_M, b - CROSSING_LENGTH_M), material, tile)
    _strip(m, shape, k, (b - CROSSING_LENGTH_M, b), Material.CROSSING, ASPHALT_TILE_M)


def junction(m: MeshBuilder, shape: BlockShape, k: int, clear_out: float, clear_in: float) -> None:
    """This block's quarter of the crossing at its corner k: clear_out m along edge k, clear_in m back along edge k - 1."""
    d_out, in_out, _ = shape.edge(k)
    d_in, in_in, _ = shape.edge(k - 1)
    node = shape.middle[k]
    out, back = node + d_out * clear_out, node - d_in * clear_in
    sides = (_steps(out, in_out, shape.half_m[k]), _steps(back, in_in, shape.half_m[k - 1])[::-1])
    rim = np.vstack([sides[0], shape.arcs[k][::-1], sides[1]])
    for outer, inner in ((1.0, 0.5), (0.5, 0.0)):
        a, b = node + outer * (rim - node), node + inner * (rim - node)
        quads = np.stack([a[:-1], a[1:], b[1:], b[:-1]], axis=1)
        m.quads(at_height(quads, 0.0), (quads - node) / ASPHALT_TILE_M, Material.ASPHALT, ROAD)
    if shape.roundabout[k]:
        island(m, shape, k)


def _steps(middle: F64, inward: F64, half_m: float) -> F64:
    """(N, 2) from a street's middle to its kerb, cut as the street's own surface is, so that no crack opens between them."""
    return np.asarray(middle + inward * np.linspace(0.0, half_m, max(1, int(np.ceil(half_m / PIECE_M))) + 1)[:, None])


def kerb_and_sidewalk(m: MeshBuilder, shape: BlockShape, k: int, verge: bool) -> None:
    """Kerb stone and pavement along edge k and around corner k, with a strip of lawn where `verge`."""
    a, b = shape.arcs[k][-1], shape.arcs[(k + 1) % len(shape.nodes)][0]
    _kerb(m, np.linspace(a, b, max(2, int(np.hypot(*(b - a)) / PIECE_M) + 1)))
    _kerb(m, shape.arcs[k])
    d, inward, _ = shape.edge(k)
    quads = grid_between(a, b, shape.back[k, 1], shape.back[k, 0], PIECE_M)
    uv = np.stack([(quads - a) @ d, (quads - a) @ inward], -1)
    m.quads(at_height(quads, KERB_M), uv / PAVER_TILE_M, Material.PAVERS, SIDEWALK)
    arc = shape.arcs[k]
    back = np.linspace(shape.back[k - 1, 1], shape.back[k, 0], len(arc))
    corner = np.stack([arc[:-1], arc[1:], back[1:], back[:-1]], axis=1)
    m.quads(at_height(corner, KERB_M), (corner - arc[0]) / PAVER_TILE_M, Material.PAVERS, SIDEWALK)
    if verge:
        lawn = grid_between(*verge_ring(shape, k), PIECE_M)
        m.quads(at_height(lawn, KERB_M + 0.015), (lawn - a) / LAWN_TILE_M, Material.LAWN, TERRAIN)


def verge_ring(shape: BlockShape, k: int) -> tuple[F64, F64, F64, F64]:
    """The corners (2,) m of the lawn strip within the sidewalk of edge k, counter-clockwise."""
    a, b = shape.arcs[k][-1], shape.arcs[(k + 1) % len(shape.nodes)][0]
    d, inward, _ = shape.edge(k)
    near, far = inward * VERGE_M[0], inward * VERGE_M[1]
    return a + near + d, b + near - d, b + far - d, a + far + d


def island_rim(node: F64, shape: BlockShape, k: int, radius_m: float = ISLAND_M) -> F64:
    """(S, 2) m: the quarter of a circle around a roundabout's node that faces the block at its corner k, counter-clockwise."""
    d_out, d_in = shape.edge(k)[0], -shape.edge(k - 1)[0]
    a0, a1 = np.arctan2(d_out[1], d_out[0]), np.arctan2(d_in[1], d_in[0])
    angle = np.linspace(a0, a0 + (a1 - a0) % (2 * np.pi), ISLAND_STEPS + 1)
    return np.asarray(node + radius_m * np.column_stack([np.cos(angle), np.sin(angle)]))


def island(m: MeshBuilder, shape: BlockShape, k: int) -> None:
    """This block's quarter of a roundabout's island: kerb, a ring of cobbles, a mound of lawn."""
    node = shape.middle[k]
    rims = [island_rim(node, shape, k, ISLAND_M - inwards) for inwards in (0.0, APRON_M, 0.5 * ISLAND_M)]
    _kerb(m, rims[0])
    ring = np.stack([rims[0][:-1], rims[0][1:], rims[1][1:], rims[1][:-1]], axis=1)
    m.quads(at_height(ring, KERB_M), (ring - node) / PAVER_TILE_M, Material.COBBLES, SIDEWALK)
    slope = np.stack([rims[1][:-1], rims[1][1:], rims[2][1:], rims[2][:-1]], axis=1)
    corners = at_height(slope, KERB_M)
    corners[:, 2:, 2] = KERB_M + MOUND_M
    m.quads(corners, (slope - node) / LAWN_TILE_M, Material.LAWN, TERRAIN)
    m.fan((*node, KERB_M + MOUND_M), at_height(rims[2], KERB_M + MOUND_M), LAWN_TILE_M, Material.LAWN, TERRAIN)


def _kerb(m: MeshBuilder, line: F64) -> None:
    """The upright face of the kerb along a line (N, 2)."""
    a, b = line[:-1], line[1:]
    corners = np.stack([at_height(a, -0.05), at_height(b, -0.05), at_height(b, KERB_M), at_height(a, KERB_M)], axis=1)
    u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(b - a, axis=1))]) / CONCRETE_TILE_M
    top, foot = np.zeros(len(a)), np.full(len(a), KERB_M / CONCRETE_TILE_M)
    uv = np.stack([np.stack(p, -1) for p in ((u[:-1], foot), (u[1:], foot), (u[1:], top), (u[:-1], top))], axis=1)
    m.quads(corners, uv, Material.CONCRETE, SIDEWALK)


def yard(m: MeshBuilder, shape: BlockShape, material: Material, class_id: int) -> None:
    """The ground behind the sidewalks."""
    loop = shape.inner
    middle = loop.mean(axis=0)
    for k in range(len(loop)):
        quads = grid_between(loop[k], loop[(k + 1) % len(loop)], middle, middle, YARD_PIECE_M)
        m.quads(at_height(quads, KERB_M - 0.02), (quads - shape.middle[0]) / LAWN_TILE_M, material, class_id)


def underlay(m: MeshBuilder, a: F64, b: F64, c: F64, d: F64) -> None:
    """A coarse lawn under the quadrilateral of corners (2,) m, counter-clockwise, that closes gaps at seams."""
    quads = grid_between(a, b, c, d, 10.0)
    m.quads(at_height(quads, UNDERLAY_M), (quads - a) / LAWN_TILE_M, Material.LAWN, TERRAIN)


def far_half(m: MeshBuilder, a: F64, b: F64, inward: F64) -> None:
    """The outer half of an outermost street, from node a to node b (2,) m: asphalt and a grass edge."""
    d = (b - a) / np.hypot(*(b - a))
    a, b = a - d * STREET_HALF_M, b + d * STREET_HALF_M
    quads = grid_between(a - inward * STREET_HALF_M, b - inward * STREET_HALF_M, b, a, PIECE_M)
    m.quads(at_height(quads, -0.02), (quads - a) / ASPHALT_TILE_M, Material.ASPHALT, ROAD)
