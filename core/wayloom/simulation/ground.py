"""Road, crossings, kerbs, sidewalks and lawns of a block, flat: the city lays them over the hills."""

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import MeshBuilder
from wayloom.simulation.paint_ground import ASPHALT_TILE_M, AVENUE_TILE_M, STREET_TILE_M
from wayloom.simulation.solids import at_height, grid_between
from wayloom.simulation.streets import AVENUE_HALF_M, CROSSING_LENGTH_M, F64, BlockShape

ROAD, SIDEWALK, TERRAIN = CLASS_ID["road"], CLASS_ID["sidewalk"], CLASS_ID["terrain"]
KERB_M = 0.12
PIECE_M = 3.0
PAVER_TILE_M, LAWN_TILE_M, CONCRETE_TILE_M = 3.0, 4.0, 4.0
VERGE_M = (0.3, 1.5)
"""A lawn strip within the sidewalk: from the kerb, m."""
UNDERLAY_M = -0.35


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
    rim = [out, out + in_out * shape.half_m[k], *shape.arcs[k][::-1], back + in_in * shape.half_m[k - 1], back]
    m.fan((*node, 0.0), at_height(np.array(rim), 0.0), ASPHALT_TILE_M, Material.ASPHALT, ROAD)


def kerb_and_sidewalk(m: MeshBuilder, shape: BlockShape, k: int, verge: bool) -> None:
    """Kerb stone and pavement along edge k and around corner k, with a strip of lawn where `verge`."""
    n = (k + 1) % len(shape.nodes)
    a, b = shape.arcs[k, -1], shape.arcs[n, 0]
    _kerb(m, np.linspace(a, b, max(2, int(np.hypot(*(b - a)) / PIECE_M) + 1)))
    _kerb(m, shape.arcs[k])
    d, inward, _ = shape.edge(k)
    quads = grid_between(a, b, shape.inner[n], shape.inner[k], PIECE_M)
    uv = np.stack([(quads - a) @ d, (quads - a) @ inward], -1)
    m.quads(at_height(quads, KERB_M), uv / PAVER_TILE_M, Material.PAVERS, SIDEWALK)
    m.fan((*shape.inner[k], KERB_M), at_height(shape.arcs[k], KERB_M), PAVER_TILE_M, Material.PAVERS, SIDEWALK)
    if verge:
        near, far = inward * VERGE_M[0], inward * VERGE_M[1]
        lawn = grid_between(a + near + d, b + near - d, b + far - d, a + far + d, PIECE_M)
        m.quads(at_height(lawn, KERB_M + 0.015), lawn / LAWN_TILE_M, Material.LAWN, TERRAIN)


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
    quads = grid_between(shape.inner[0], shape.inner[1], shape.inner[2], shape.inner[3], 5.0)
    m.quads(at_height(quads, KERB_M - 0.02), quads / LAWN_TILE_M, material, class_id)


def underlay(m: MeshBuilder, low: F64, high: F64) -> None:
    """A coarse plane under everything, so that no ray slips through a seam; lawn outside the city."""
    x, y = np.arange(low[0], high[0] + 10, 10.0), np.arange(low[1], high[1] + 10, 10.0)
    quads = grid_between((x[0], y[0]), (x[-1], y[0]), (x[-1], y[-1]), (x[0], y[-1]), 10.0)
    m.quads(at_height(quads, UNDERLAY_M), quads / LAWN_TILE_M, Material.LAWN, TERRAIN)
