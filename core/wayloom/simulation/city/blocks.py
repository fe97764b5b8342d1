"""City blocks by land use: buildings, gardens, parks and squares between the streets."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city import buildings, furniture, ground, kerbside
from wayloom.simulation.city.block_context import BlockContext, SignalFace
from wayloom.simulation.city.buildings import Footprint
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.instance_ids import first_number
from wayloom.simulation.city.objects import Change, TrueObject
from wayloom.simulation.city.streets import F64, ISLAND_M, StreetGraph
from wayloom.simulation.models import vegetation
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.models.mesh import Mesh, MeshBuilder
from wayloom.simulation.textures.materials import Material

HOUSE_DEPTH_M = 10.0
LOT_M = (9.0, 16.0)
GARDEN_M = (3.0, 6.0)
CHAMFER_M = 7.0
"""How much shorter the back of a sidewalk is where there is a roundabout."""
SURROUNDINGS_M, TREES_PER_M_OF_BORDER = 90.0, 0.12
VERGE_SHARE = 0.35
GROUND, STANDING, FURNITURE, PARKED, CROSSINGS = range(5)
"""The stages of a block, each with random numbers of its own: a change in one leaves the others as they are."""
STAGES = (
    (FURNITURE, kerbside.sidewalk_furniture),
    (PARKED, kerbside.parked_vehicles),
    (CROSSINGS, kerbside.crossing_furniture),
)


class LandUse(Enum):
    """Land use of a block."""

    DENSE = 0
    GARDENS = 1
    PARK = 2
    SQUARE = 3


LAND_USE_TILE = 4
LAND_USES = (LandUse.DENSE,) * 9 + (LandUse.GARDENS,) * 4 + (LandUse.PARK,) * 2 + (LandUse.SQUARE,)


FACADE_CHANGES_EVERY = 3


@dataclass(frozen=True, slots=True)
class BuiltBlock:
    """A block over flat ground: triangles, objects, changes against the unchanged city, signal faces."""

    mesh: Mesh
    objects: tuple[TrueObject, ...]
    changes: tuple[Change, ...]
    faces: tuple[SignalFace, ...]


def land_use(settings: CitySettings, block: int) -> LandUse:
    """Land use of a block: all LAND_USE_TILE x LAND_USE_TILE groups hold the same mixture, each in another order."""
    if settings.hard:
        return LandUse.DENSE
    row, column = divmod(block, settings.columns - 1)
    order = np.random.default_rng([settings.seed, 1, row // LAND_USE_TILE, column // LAND_USE_TILE]).permutation(len(LAND_USES))
    return LAND_USES[order[row % LAND_USE_TILE * LAND_USE_TILE + column % LAND_USE_TILE]]


def verges(settings: CitySettings, block: int) -> tuple[bool, ...]:
    """For each edge of a block, whether there is a strip of lawn within the sidewalk."""
    return tuple((_stream(settings, block, GROUND).random(4) < VERGE_SHARE).tolist())


def _stream(settings: CitySettings, block: int, stage: int) -> np.random.Generator:
    """Random stream of one stage of one block; in a hard city the same for all blocks."""
    return np.random.default_rng([settings.seed, 2, 0 if settings.hard else block, stage])


def build_block(settings: CitySettings, graph: StreetGraph, models: Models, block: int, coarse: bool = False) -> BuiltBlock:
    """Build a block and its kerbside. coarse: the level of detail for far views, without vehicles and furniture."""
    change_rng = np.random.default_rng([settings.seed, 20, block]) if settings.changed else None
    repaint = change_rng if block % FACADE_CHANGES_EVERY == settings.seed % FACADE_CHANGES_EVERY else None
    m, shape = MeshBuilder(coarse), graph.shape(block)
    context = BlockContext(
        m, graph, shape, models, _stream(settings, block, STANDING), first_number(settings, block), change_rng, repaint
    )
    kind, strips = land_use(settings, block), verges(settings, block)
    clear = [(graph.clear_m(a, b), graph.clear_m(b, a)) for a, b in shape.edges()]
    for k in range(len(shape.nodes)):
        ground.half_street(m, shape, k, clear[k])
        ground.junction(m, shape, k, clear[k][0], clear[k - 1][1])
        ground.kerb_and_sidewalk(m, shape, k, strips[k])
    square = kind is LandUse.SQUARE
    ground.yard(m, shape, Material.COBBLES if square else Material.LAWN, CLASS_ID["sidewalk" if square else "terrain"])
    {LandUse.DENSE: _dense, LandUse.GARDENS: _gardens, LandUse.PARK: _park, LandUse.SQUARE: _square}[kind](context)
    _roundabouts(context)
    ground.underlay(m, *shape.middle)
    _outskirts(context, np.random.default_rng([settings.seed, 3, block]))
    if not coarse:
        for stage, build in STAGES:
            context.rng = _stream(settings, block, stage)
            for k in range(len(shape.nodes)):
                build(context, k, clear[k])
    return BuiltBlock(m.build(), tuple(context.objects), tuple(context.changes), tuple(context.faces))


def _lots(context: BlockContext, k: int, trimmed_m: float) -> list[tuple[F64, F64]]:
    """The back line of sidewalk k cut into lots, leaving trimmed_m free at both ends."""
    shape = context.shape
    a, b = shape.back[k]
    length = float(np.hypot(*(b - a)))
    at_start, at_end = (max(0.0, trimmed_m - CHAMFER_M) if shape.roundabout[n % 4] else trimmed_m for n in (k, k + 1))
    d, s, end, lots = (b - a) / length, at_start, length - at_end, []
    while s < end - 4:
        width = min(context.rng.uniform(*LOT_M), end - s)
        width = end - s if end - s - width < 6 else width
        lots.append((a + d * s, a + d * (s + width)))
        s += width
    return lots


def _dense(context: BlockContext) -> None:
    """Closed rows of town houses, with a gap here and there."""
    for k in range(len(context.shape.nodes)):
        storeys = int(context.rng.integers(2, 5))
        for p, q in _lots(context, k, 0.0 if k % 2 == 0 else HOUSE_DEPTH_M + 1):
            d = q - p
            inward = np.array([-d[1], d[0]]) / np.hypot(*d)
            chance = context.rng.random()
            if chance < 0.84:
                back = inward * (0.0 if context.rng.random() < 0.6 else context.rng.uniform(0.2, 1.5))
                floors = int(np.clip(storeys + context.rng.integers(-1, 2), 1, 5))
                _house(context, buildings.town_house, Footprint(p + back, q + back, HOUSE_DEPTH_M), floors)
            else:
                _boundary(context, p, q)
                middle = (p + q) / 2 + inward * context.rng.uniform(3, 6)
                _tree(context, middle, context.rng.uniform(1.1, 1.7))


def _gardens(context: BlockContext) -> None:
    """Detached houses behind hedges, fences and walls."""
    for k in range(len(context.shape.nodes)):
        for p, q in _lots(context, k, 0.0 if k % 2 == 0 else 18.0):
            d = (q - p) / np.hypot(*(q - p))
            inward, width = np.array([-d[1], d[0]]), float(np.hypot(*(q - p)))
            garden, side = context.rng.uniform(*GARDEN_M), context.rng.uniform(0.6, 1.6)
            front = (p + d * side + inward * garden, q - d * side + inward * garden)
            if width > 8:
                foot = Footprint(*front, context.rng.uniform(8.5, 11.0))
                _house(context, buildings.detached_house, foot, int(context.rng.integers(1, 3)))
            _boundary(context, p, q)
            for _ in range(context.rng.integers(0, 3)):
                at = p + d * context.rng.uniform(0.1, 0.9) * width + inward * context.rng.uniform(0.8, garden - 0.8)
                vegetation.bush(context.m, context.rng, at[0], at[1], context.number(), context.rng.uniform(0.8, 1.6))
            if context.rng.random() < 0.55:
                _tree(context, p + d * side * 0.5 + inward * (garden + 1), context.rng.uniform(0.8, 1.3))


def _boundary(context: BlockContext, p: F64, q: F64) -> None:
    """A hedge, fence or wall along the back of the sidewalk."""
    chance, number = context.rng.random(), context.number()
    if chance < 0.36:
        vegetation.hedge(context.m, context.rng, p, q, number, context.rng.uniform(0.9, 1.9))
    elif chance < 0.68:
        furniture.fence(context.m, p, q, number, context.rng)
    else:
        furniture.garden_wall(context.m, p, q, number, context.rng)


def _inside(context: BlockContext) -> F64:
    """A random place (2,) within the block, away from its edges."""
    weights = context.rng.dirichlet(np.full(len(context.shape.inner), 0.8))
    return np.asarray(0.88 * (weights @ context.shape.inner) + 0.12 * context.shape.inner.mean(axis=0))


def _park(context: BlockContext) -> None:
    """Trees and bushes on a lawn, a low fence, wall or hedge around it."""
    for k in range(len(context.shape.nodes)):
        for p, q in _lots(context, k, 1.0):
            if context.rng.random() < 0.6:
                _boundary(context, p, q)
    for _ in range(26):
        _tree(context, _inside(context), context.rng.uniform(1.1, 2.0))
    for _ in range(24):
        x, y = _inside(context)
        vegetation.bush(context.m, context.rng, x, y, context.number(), context.rng.uniform(0.8, 2.0))


def _square(context: BlockContext) -> None:
    """A paved square with a ring of trees, a hall in its middle, shelters and bollards."""
    inner, centre = context.shape.inner, context.shape.inner.mean(axis=0)
    for share in (0.75, 0.9):
        loop = centre + (inner - centre) * share
        for k in range(len(loop)):
            a, b = loop[k], loop[(k + 1) % len(loop)]
            for s in np.arange(0.08, 1.0, 0.16):
                _tree(context, a + (b - a) * s, context.rng.uniform(0.9, 1.3))
    p, q = centre + np.array([-9, -5]), centre + np.array([9, -5])
    _house(context, buildings.town_house, Footprint(p, q, HOUSE_DEPTH_M), 2)


HouseBuilder = Callable[[MeshBuilder, Footprint, int, int, np.random.Generator, np.random.Generator | None], None]


def _house(context: BlockContext, build: HouseBuilder, foot: Footprint, floors: int) -> None:
    """A house; in some blocks of a changed city the first one has another facade."""
    number = context.number()
    build(context.m, foot, floors, number, context.rng, context.repaint)
    if context.repaint is not None:
        middle = (foot.p + foot.q) / 2
        context.changes.append(Change("altered", CLASS_ID["building"], number, np.array([*middle, KERB_M])))
        context.repaint = None


def _tree(context: BlockContext, at: F64, big: float) -> None:
    """A broad tree, or now and then a conifer."""
    plant = vegetation.conifer if context.rng.random() < 0.14 else vegetation.broadleaf
    plant(context.m, context.rng, at[0], at[1], context.number(), big)


def _roundabouts(context: BlockContext) -> None:
    """Objects on a roundabout's island; the block north-east of it builds the island's, all four build its signs."""
    for k, node in enumerate(context.shape.middle):
        if not context.shape.roundabout[k]:
            continue
        d, inward, _ = context.shape.edge(k)
        kerbside.sign(context, node + d * (ISLAND_M - 0.5) + inward * 0.9, d, 4)
        if k == 0:
            buildings.monument(context.m, node, context.number())
            for angle in np.arange(5) * 2 * np.pi / 5 + context.rng.random():
                x, y = node + 4.3 * np.array([np.cos(angle), np.sin(angle)])
                vegetation.bush(context.m, context.rng, float(x), float(y), context.number(), 1.1)


def _outskirts(context: BlockContext, rng: np.random.Generator) -> None:
    """Beyond the city's outermost streets: the other half of the carriageway, a meadow and a belt of trees."""
    shape, graph = context.shape, context.graph
    for k, (a, b) in enumerate(shape.edges()):
        if not graph.is_outer(a, b):
            continue
        d, inward, length = shape.edge(k)
        p, q = shape.middle[k], shape.middle[(k + 1) % 4]
        reach_p, reach_q = (SURROUNDINGS_M if k % 2 == 0 and graph.is_corner(n) else 0.0 for n in (a, b))
        out = -inward * SURROUNDINGS_M
        ground.underlay(context.m, p - d * reach_p + out, q + d * reach_q + out, q + d * reach_q, p - d * reach_p)
        ground.far_half(context.m, p, q, inward)
        for _ in range(int((length + reach_p + reach_q) * TREES_PER_M_OF_BORDER)):
            x, y = p + d * rng.uniform(-reach_p, length + reach_q) - inward * rng.uniform(14, 40)
            vegetation.broadleaf(context.m, rng, float(x), float(y), context.number(), rng.uniform(1.4, 2.2))
