"""What stands in a block and along its kerbs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation import buildings, furniture, ground, vegetation
from wayloom.simulation.buildings import Footprint
from wayloom.simulation.city_settings import CitySettings
from wayloom.simulation.ground import KERB_M
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import Mesh, MeshBuilder, placed
from wayloom.simulation.models import Models
from wayloom.simulation.numbering import THINGS_PER_BLOCK, first_number
from wayloom.simulation.objects import Change, TrueObject
from wayloom.simulation.streets import (
    AVENUE_HALF_M,
    CROSSING_LENGTH_M,
    F64,
    ISLAND_M,
    SIDEWALK_M,
    BlockShape,
    Control,
    StreetGraph,
)

HOUSE_DEPTH_M = 10.0
LOT_M = (9.0, 16.0)
GARDEN_M = (3.0, 6.0)
PARKING_FROM_KERB_M = 1.05
SHELTER_BACK_M = 1.7
CHAMFER_M = 7.0
"""How much shorter the back of a sidewalk is where there is a roundabout."""
SURROUNDINGS_M, TREES_PER_M_OF_BORDER = 90.0, 0.12
VERGE_SHARE = 0.35
POLE, SIGN, LIGHT = CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["traffic light"]
GROUND, STANDING, FURNITURE, PARKED, CROSSINGS = range(5)
"""The stages of a block, each with random numbers of its own: a change in one leaves the others as they are."""
TREE, SIGNPOST, BOLLARDS, BIKES, CABINET, MOTORBIKES = range(6)
FURNITURE_SHARES = (0.40, 0.22, 0.11, 0.12, 0.07, 0.08)


class Kind(Enum):
    """What a block is built up with."""

    DENSE = 0
    GARDENS = 1
    PARK = 2
    SQUARE = 3


KINDS_TILE = 4
KINDS = (Kind.DENSE,) * 9 + (Kind.GARDENS,) * 4 + (Kind.PARK,) * 2 + (Kind.SQUARE,)


CHANGED_SHARES = {"sign": (0.16, 0.12), "pole": (0.08, 0.05), "vehicle": (0.30, 0.25)}
"""In a changed city: how many things of a kind are gone, and how many are elsewhere (vehicles: another one stands there)."""
MOVED_M = 1.7
FACADE_CHANGES_EVERY = 3


class Fate(Enum):
    """What has become of a thing in a changed city."""

    KEPT = 0
    GONE = 1
    ELSEWHERE = 2


@dataclass(frozen=True, slots=True)
class SignalFace:
    """The lamps of one signal head: at (3,) m over the flat city, facing (2,), for who comes from node `origin` to `node`."""

    at: F64
    facing: F64
    node: int
    origin: int
    number: int


@dataclass(slots=True)
class Site:
    """What the builders of one block share. rng is that of the stage being built; fates and repaint are None in an unchanged city.

    Noted things have their feet on a flat city: the city lifts them onto its hills.
    """

    m: MeshBuilder
    graph: StreetGraph
    shape: BlockShape
    models: Models
    rng: np.random.Generator
    first_number: int
    fates: np.random.Generator | None = None
    repaint: np.random.Generator | None = None
    given: int = 0
    objects: list[TrueObject] = field(default_factory=list)
    changes: list[Change] = field(default_factory=list)
    faces: list[SignalFace] = field(default_factory=list)

    def number(self) -> int:
        """A number that no other thing of this block has; the last one again where there are no more."""
        self.given = min(self.given + 1, THINGS_PER_BLOCK)
        return self.first_number + self.given - 1

    def note(self, class_id: int, number: int, at: F64, bottom_m: float, top_m: float) -> None:
        """Remember an object over the sidewalk at (2,) m, from bottom_m to top_m above the street's plane."""
        foot = np.array([at[0], at[1], KERB_M])
        self.objects.append(TrueObject(class_id, number, foot, max(0.0, bottom_m - KERB_M), top_m - KERB_M))

    def fate(self, kind: str) -> Fate:
        """What has become of the next thing of a kind."""
        if self.fates is None:
            return Fate.KEPT
        gone, elsewhere = CHANGED_SHARES[kind]
        chance = self.fates.random()
        return Fate.GONE if chance < gone else Fate.ELSEWHERE if chance < gone + elsewhere else Fate.KEPT


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
        for stage, build in ((FURNITURE, _sidewalk_furniture), (PARKED, _parked_vehicles), (CROSSINGS, _crossing_furniture)):
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


def _kerb_point(shape: BlockShape, k: int, along_m: float, in_m: float) -> F64:
    """A place `along_m` m along street edge k from its node and `in_m` m behind the kerb (negative: on the road)."""
    d, inward, _ = shape.edge(k)
    return np.asarray(shape.middle[k] + d * along_m + inward * (shape.half_m[k] + in_m))


def _sidewalk_furniture(site: Site, k: int, clear: tuple[float, float]) -> None:
    """Lamps at even distance, and between them trees, signs, bollards, bicycles, cabinets, motorcycles."""
    shape, rng = site.shape, site.rng
    d, inward, length = shape.edge(k)
    first, last, yaw = clear[0] + 2, length - clear[1] - 2, float(np.arctan2(d[1], d[0]))
    for s in np.arange(first + 3, last, rng.uniform(20, 26)):
        _lamp(site, _kerb_point(shape, k, s, 0.45), d, -inward)
    for s in np.arange(first + rng.uniform(6, 9), last, rng.uniform(5.5, 9)):
        at, kind = _kerb_point(shape, k, s, 0.75), rng.choice(len(FURNITURE_SHARES), p=FURNITURE_SHARES)
        if kind == TREE:
            vegetation.broadleaf(site.m, rng, at[0], at[1], site.number(), rng.uniform(0.8, 1.2))
        elif kind == SIGNPOST:
            _sign(site, at, d, int(rng.integers(furniture.SIGN_KINDS)))
        elif kind == BOLLARDS:
            for step in range(4):
                number, place = site.number(), at + d * 1.3 * step
                furniture.bollard(site.m, place, number)
                site.note(POLE, number, place, 0.0, furniture.BOLLARD_TOP_M)
        elif kind in (BIKES, MOTORBIKES):
            model = site.models.any_bicycle if kind == BIKES else site.models.any_motorcycle
            for step in range(int(rng.integers(1, 4))):
                turn = yaw + np.pi / 2 + rng.normal(0, 0.15)
                x, y = at + d * 0.7 * step
                site.m.add(placed(model(rng), float(x), float(y), turn, KERB_M, site.number()))
        else:
            furniture.cabinet(site.m, at, yaw, site.number(), rng)
    if shape.half_m[k] == AVENUE_HALF_M:
        furniture.shelter(site.m, _kerb_point(shape, k, (first + last) / 2, SHELTER_BACK_M), d, -inward, site.number())


def _lamp(site: Site, at: F64, along: F64, to_street: F64) -> None:
    """A street lamp, or, in a changed city, perhaps none, or one beside its old place."""
    number, fate = site.number(), site.fate("pole")
    for place in _told(site, fate, POLE, number, at, along):
        furniture.lamp_post(site.m, place, to_street, number)
        site.note(POLE, number, place, 0.0, furniture.LAMP_TOP_M)


def _sign(site: Site, at: F64, facing: F64, kind: int) -> None:
    """A sign on its post, or, in a changed city, perhaps none, or one beside its old place."""
    post, plate, fate = site.number(), site.number(), site.fate("sign")
    _told(site, fate, POLE, post, at, facing)
    for place in _told(site, fate, SIGN, plate, at, facing):
        furniture.sign_post(site.m, place, facing, kind, post, plate)
        site.note(POLE, post, place, 0.0, furniture.SIGN_POST_TOP_M)
        site.note(SIGN, plate, place, *furniture.SIGN_M)


def _told(site: Site, fate: Fate, class_id: int, number: int, at: F64, along: F64) -> list[F64]:
    """Where a thing stands after its fate, if at all; notes the change."""
    new = [] if fate is Fate.GONE else [at + along * MOVED_M] if fate is Fate.ELSEWHERE else [at]
    if fate is not Fate.KEPT:
        site.changes.append(Change("removed", class_id, number, np.array([*at, KERB_M])))
        site.changes += [Change("added", class_id, number, np.array([*place, KERB_M])) for place in new]
    return new


def _parked_vehicles(site: Site, k: int, clear: tuple[float, float]) -> None:
    """Vehicles at the kerb, facing as the traffic beside them drives: with the kerb on their right. Long ones along avenues."""
    shape, rng = site.shape, site.rng
    _, _, length = shape.edge(k)
    avenue, full = shape.half_m[k] == AVENUE_HALF_M, rng.uniform(0.35, 0.85)
    s, end = clear[0] + CROSSING_LENGTH_M + 4, length - clear[1] - CROSSING_LENGTH_M - 3
    while s < end:
        chance, needed = rng.random(), rng.uniform(5.4, 6.6)
        if chance < full:
            kind = rng.random()
            if avenue and kind < 0.22 and s + 13 < end:
                lorry = kind < 0.13
                mesh = site.models.painted(site.models.lorry if lorry else site.models.bus, rng)
                s, needed, from_kerb = (s + 2.0, 8.0, 1.4) if lorry else (s + 4.0, 10.0, 1.45)
            elif kind > 0.95:
                mesh, from_kerb = site.models.any_motorcycle(rng), PARKING_FROM_KERB_M
            else:
                mesh, from_kerb = site.models.any_car(rng), PARKING_FROM_KERB_M
            _park_one(site, k, mesh, s, from_kerb)
        s += needed


def _park_one(site: Site, k: int, mesh: Mesh, along_m: float, from_kerb_m: float) -> None:
    """One vehicle at the kerb; in a changed city it may have left, or another one may stand there."""
    rng, (d, _, _) = site.rng, site.shape.edge(k)
    small = from_kerb_m == PARKING_FROM_KERB_M
    at = _kerb_point(site.shape, k, along_m, -from_kerb_m + rng.normal(0, 0.05 if small else 0.02))
    scale = (rng.uniform(0.93, 1.06), rng.uniform(0.97, 1.03), rng.uniform(0.97, 1.06)) if small else (1.0, 1.0, 1.0)
    yaw = float(np.arctan2(-d[1], -d[0])) + rng.normal(0, 0.025 if small else 0.004)
    number, fate, class_id = site.number(), site.fate("vehicle"), int(mesh.class_id[0])
    if fate is not Fate.KEPT:
        site.changes.append(Change("removed", class_id, number, np.array([*at, 0.0])))
    if fate is Fate.ELSEWHERE and site.fates is not None:
        mesh = site.models.any_car(site.fates)
        site.changes.append(Change("added", int(mesh.class_id[0]), number, np.array([*at, 0.0])))
    if fate is not Fate.GONE:
        site.m.add(placed(mesh, at[0], at[1], yaw, 0.0, number, scale))


def _crossing_furniture(site: Site, k: int, clear: tuple[float, float]) -> None:
    """Traffic lights or signs for those who come along edge k towards its first node, and railings at some corners."""
    shape, rng = site.shape, site.rng
    d, _, _ = shape.edge(k)
    at = _kerb_point(shape, k, clear[0] + 4.4, 0.55)
    control, chance = site.graph.control(shape.nodes[k]), rng.random()
    if control is Control.SIGNALS:
        _signal(site, k, at, 3.8 if shape.half_m[k] == AVENUE_HALF_M or chance < 0.4 else 0.0)
    else:
        _sign(site, at, d, 3 if control is Control.ROUNDABOUT else int(rng.choice((3, 5, 2))))
    _sign(site, _kerb_point(shape, k, clear[0] + 0.4, 0.6), d, 7)
    if rng.random() < 0.4:
        a, b = (_kerb_point(shape, k, clear[0] + s, 0.3) for s in (5.0, 11.0))
        furniture.guard_rail(site.m, a, b, site.number())


def _signal(site: Site, k: int, at: F64, arm_m: float) -> None:
    """A traffic light whose heads each have a number of their own."""
    d, inward, _ = site.shape.edge(k)
    post, node, origin = site.number(), site.shape.nodes[k], site.shape.nodes[(k + 1) % 4]
    heads = furniture.traffic_light(site.m, at, d, -inward, arm_m, post, [site.number() for _ in range(1 + (arm_m > 0))])
    site.note(POLE, post, at, 0.0, furniture.signal_post_m(arm_m))
    for face, number in heads:
        site.faces.append(SignalFace(face, d, node, origin, number))
        site.note(LIGHT, number, face[:2] - d * furniture.SIGNAL_HALF_M, face[2], face[2] + furniture.SIGNAL_M)


def _roundabouts(site: Site) -> None:
    """What stands on a roundabout's island; each is looked after by the block north-east of it, and its signs by all four."""
    for k, node in enumerate(site.shape.middle):
        if not site.shape.roundabout[k]:
            continue
        d, inward, _ = site.shape.edge(k)
        _sign(site, node + d * (ISLAND_M - 0.5) + inward * 0.9, d, 4)
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


SIDEWALK_MIDDLE_M = SIDEWALK_M * 0.62
"""Where people walk, from the kerb."""
