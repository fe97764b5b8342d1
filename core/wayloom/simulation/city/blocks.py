"""City blocks by land use: buildings, gardens, parks and squares between the streets."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city import buildings, furniture, ground, kerbside
from wayloom.simulation.city.buildings import Footprint
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.numbering import first_number
from wayloom.simulation.city.objects import Change, TrueObject
from wayloom.simulation.city.site import SignalFace, Site
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


class Kind(Enum):
    """What a block is built up with."""

    DENSE = 0
    GARDENS = 1
    PARK = 2
    SQUARE = 3


KINDS_TILE = 4
KINDS = (Kind.DENSE,) * 9 + (Kind.GARDENS,) * 4 + (Kind.PARK,) * 2 + (Kind.SQUARE,)


FACADE_CHANGES_EVERY = 3


@dataclass(frozen=True, slots=True)
class Built:
    """A block over flat ground: its triangles, its objects, what changed in it, its signals' faces."""

    mesh: Mesh
    objects: tuple[TrueObject, ...]
    changes: tuple[Change, ...]
    faces: tuple[SignalFace, ...]


def kind_of(settings: CitySettings, block: int) -> Kind:
    """What a block is built up with: of every KINDS_TILE x KINDS_TILE blocks the same mixture, in another order each."""
    if settings.hard:
        return Kind.DENSE
    row, column = divmod(block, settings.columns - 1)
    order = np.random.default_rng([settings.seed, 1, row // KINDS_TILE, column // KINDS_TILE]).permutation(len(KINDS))
    return KINDS[order[row % KINDS_TILE * KINDS_TILE + column % KINDS_TILE]]


def verges(settings: CitySettings, block: int) -> tuple[bool, ...]:
    """For each edge of a block, whether there is a strip of lawn within the sidewalk."""
    return tuple((_stream(settings, block, GROUND).random(4) < VERGE_SHARE).tolist())


def _stream(settings: CitySettings, block: int, stage: int) -> np.random.Generator:
    """The random numbers of one stage of one block; of a hard city's blocks all are the same."""
    return np.random.default_rng([settings.seed, 2, 0 if settings.hard else block, stage])


def build_block(settings: CitySettings, graph: StreetGraph, models: Models, block: int, coarse: bool = False) -> Built:
    """Everything in a block and along its kerbs. coarse: as it is seen from afar, without vehicles and furniture."""
    fates = np.random.default_rng([settings.seed, 20, block]) if settings.changed else None
    repaint = fates if block % FACADE_CHANGES_EVERY == settings.seed % FACADE_CHANGES_EVERY else None
    m, shape = MeshBuilder(coarse), graph.shape(block)
    site = Site(m, graph, shape, models, _stream(settings, block, STANDING), first_number(settings, block), fates, repaint)
    kind, strips = kind_of(settings, block), verges(settings, block)
    clear = [(graph.clear_m(a, b), graph.clear_m(b, a)) for a, b in shape.edges()]
    for k in range(len(shape.nodes)):
        ground.half_street(m, shape, k, clear[k])
        ground.junction(m, shape, k, clear[k][0], clear[k - 1][1])
        ground.kerb_and_sidewalk(m, shape, k, strips[k])
    square = kind is Kind.SQUARE
    ground.yard(m, shape, Material.COBBLES if square else Material.LAWN, CLASS_ID["sidewalk" if square else "terrain"])
    {Kind.DENSE: _dense, Kind.GARDENS: _gardens, Kind.PARK: _park, Kind.SQUARE: _square}[kind](site)
    _roundabouts(site)
    ground.underlay(m, *shape.middle)
    _outskirts(site, np.random.default_rng([settings.seed, 3, block]))
    if not coarse:
        for stage, build in STAGES:
            site.rng = _stream(settings, block, stage)
            for k in range(len(shape.nodes)):
                build(site, k, clear[k])
    return Built(m.build(), tuple(site.objects), tuple(site.changes), tuple(site.faces))


def _lots(site: Site, k: int, trimmed_m: float) -> list[tuple[F64, F64]]:
    """The back line of sidewalk k cut into lots, leaving trimmed_m free at both ends."""
    shape = site.shape
    a, b = shape.back[k]
    length = float(np.hypot(*(b - a)))
    at_start, at_end = (max(0.0, trimmed_m - CHAMFER_M) if shape.roundabout[n % 4] else trimmed_m for n in (k, k + 1))
    d, s, end, lots = (b - a) / length, at_start, length - at_end, []
    while s < end - 4:
        width = min(site.rng.uniform(*LOT_M), end - s)
        width = end - s if end - s - width < 6 else width
        lots.append((a + d * s, a + d * (s + width)))
        s += width
    return lots


def _dense(site: Site) -> None:
    """Closed rows of town houses, with a gap here and there."""
    for k in range(len(site.shape.nodes)):
        storeys = int(site.rng.integers(2, 5))
        for p, q in _lots(site, k, 0.0 if k % 2 == 0 else HOUSE_DEPTH_M + 1):
            d = q - p
            inward = np.array([-d[1], d[0]]) / np.hypot(*d)
            chance = site.rng.random()
            if chance < 0.84:
                back = inward * (0.0 if site.rng.random() < 0.6 else site.rng.uniform(0.2, 1.5))
                floors = int(np.clip(storeys + site.rng.integers(-1, 2), 1, 5))
                _house(site, buildings.town_house, Footprint(p + back, q + back, HOUSE_DEPTH_M), floors)
            else:
                _boundary(site, p, q)
                middle = (p + q) / 2 + inward * site.rng.uniform(3, 6)
                _tree(site, middle, site.rng.uniform(1.1, 1.7))


def _gardens(site: Site) -> None:
    """Detached houses behind hedges, fences and walls."""
    for k in range(len(site.shape.nodes)):
        for p, q in _lots(site, k, 0.0 if k % 2 == 0 else 18.0):
            d = (q - p) / np.hypot(*(q - p))
            inward, width = np.array([-d[1], d[0]]), float(np.hypot(*(q - p)))
            garden, side = site.rng.uniform(*GARDEN_M), site.rng.uniform(0.6, 1.6)
            front = (p + d * side + inward * garden, q - d * side + inward * garden)
            if width > 8:
                foot = Footprint(*front, site.rng.uniform(8.5, 11.0))
                _house(site, buildings.detached_house, foot, int(site.rng.integers(1, 3)))
            _boundary(site, p, q)
            for _ in range(site.rng.integers(0, 3)):
                at = p + d * site.rng.uniform(0.1, 0.9) * width + inward * site.rng.uniform(0.8, garden - 0.8)
                vegetation.bush(site.m, site.rng, at[0], at[1], site.number(), site.rng.uniform(0.8, 1.6))
            if site.rng.random() < 0.55:
                _tree(site, p + d * side * 0.5 + inward * (garden + 1), site.rng.uniform(0.8, 1.3))


def _boundary(site: Site, p: F64, q: F64) -> None:
    """A hedge, a fence or a wall along the back of the sidewalk."""
    chance, number = site.rng.random(), site.number()
    if chance < 0.36:
        vegetation.hedge(site.m, site.rng, p, q, number, site.rng.uniform(0.9, 1.9))
    elif chance < 0.68:
        furniture.fence(site.m, p, q, number, site.rng)
    else:
        furniture.garden_wall(site.m, p, q, number, site.rng)


def _inside(site: Site) -> F64:
    """A random place (2,) within the block, away from its edges."""
    weights = site.rng.dirichlet(np.full(len(site.shape.inner), 0.8))
    return np.asarray(0.88 * (weights @ site.shape.inner) + 0.12 * site.shape.inner.mean(axis=0))


def _park(site: Site) -> None:
    """Trees and bushes on a lawn, a low fence, wall or hedge around it."""
    for k in range(len(site.shape.nodes)):
        for p, q in _lots(site, k, 1.0):
            if site.rng.random() < 0.6:
                _boundary(site, p, q)
    for _ in range(26):
        _tree(site, _inside(site), site.rng.uniform(1.1, 2.0))
    for _ in range(24):
        x, y = _inside(site)
        vegetation.bush(site.m, site.rng, x, y, site.number(), site.rng.uniform(0.8, 2.0))


def _square(site: Site) -> None:
    """A paved square with a ring of trees, a hall in its middle, shelters and bollards."""
    inner, centre = site.shape.inner, site.shape.inner.mean(axis=0)
    for share in (0.75, 0.9):
        loop = centre + (inner - centre) * share
        for k in range(len(loop)):
            a, b = loop[k], loop[(k + 1) % len(loop)]
            for s in np.arange(0.08, 1.0, 0.16):
                _tree(site, a + (b - a) * s, site.rng.uniform(0.9, 1.3))
    p, q = centre + np.array([-9, -5]), centre + np.array([9, -5])
    _house(site, buildings.town_house, Footprint(p, q, HOUSE_DEPTH_M), 2)


HouseBuilder = Callable[[MeshBuilder, Footprint, int, int, np.random.Generator, np.random.Generator | None], None]


def _house(site: Site, build: HouseBuilder, foot: Footprint, floors: int) -> None:
    """A house; in some blocks of a changed city the first one has another facade."""
    number = site.number()
    build(site.m, foot, floors, number, site.rng, site.repaint)
    if site.repaint is not None:
        middle = (foot.p + foot.q) / 2
        site.changes.append(Change("altered", CLASS_ID["building"], number, np.array([*middle, KERB_M])))
        site.repaint = None


def _tree(site: Site, at: F64, big: float) -> None:
    """A broad tree, or now and then a conifer."""
    plant = vegetation.conifer if site.rng.random() < 0.14 else vegetation.broadleaf
    plant(site.m, site.rng, at[0], at[1], site.number(), big)


def _roundabouts(site: Site) -> None:
    """What stands on a roundabout's island; each is looked after by the block north-east of it, and its signs by all four."""
    for k, node in enumerate(site.shape.middle):
        if not site.shape.roundabout[k]:
            continue
        d, inward, _ = site.shape.edge(k)
        kerbside.sign(site, node + d * (ISLAND_M - 0.5) + inward * 0.9, d, 4)
        if k == 0:
            buildings.monument(site.m, node, site.number())
            for angle in np.arange(5) * 2 * np.pi / 5 + site.rng.random():
                x, y = node + 4.3 * np.array([np.cos(angle), np.sin(angle)])
                vegetation.bush(site.m, site.rng, float(x), float(y), site.number(), 1.1)


def _outskirts(site: Site, rng: np.random.Generator) -> None:
    """Beyond the city's outermost streets: the other half of the carriageway, a meadow and a belt of trees."""
    shape, graph = site.shape, site.graph
    for k, (a, b) in enumerate(shape.edges()):
        if not graph.is_outer(a, b):
            continue
        d, inward, length = shape.edge(k)
        p, q = shape.middle[k], shape.middle[(k + 1) % 4]
        reach_p, reach_q = (SURROUNDINGS_M if k % 2 == 0 and graph.is_corner(n) else 0.0 for n in (a, b))
        out = -inward * SURROUNDINGS_M
        ground.underlay(site.m, p - d * reach_p + out, q + d * reach_q + out, q + d * reach_q, p - d * reach_p)
        ground.far_half(site.m, p, q, inward)
        for _ in range(int((length + reach_p + reach_q) * TREES_PER_M_OF_BORDER)):
            x, y = p + d * rng.uniform(-reach_p, length + reach_q) - inward * rng.uniform(14, 40)
            vegetation.broadleaf(site.m, rng, float(x), float(y), site.number(), rng.uniform(1.4, 2.2))
