"""What stands in a block and along its kerbs."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation import buildings, furniture, ground, vegetation
from wayloom.simulation.buildings import Footprint
from wayloom.simulation.ground import KERB_M
from wayloom.simulation.materials import Material
from wayloom.simulation.mesh import MeshBuilder, placed
from wayloom.simulation.models import Models
from wayloom.simulation.streets import AVENUE_HALF_M, CROSSING_LENGTH_M, F64, SIDEWALK_M, BlockShape

HOUSE_DEPTH_M = 10.0
LOT_M = (9.0, 16.0)
GARDEN_M = (3.0, 6.0)
PARKING_FROM_KERB_M = 1.05
TREE, SIGNPOST, BOLLARDS, BIKES, CABINET, MOTORBIKES = range(6)
FURNITURE_SHARES = (0.40, 0.22, 0.11, 0.12, 0.07, 0.08)


class Kind(Enum):
    """What a block is built up with."""

    DENSE = 0
    GARDENS = 1
    PARK = 2
    SQUARE = 3


KIND_SHARES = (0.55, 0.27, 0.10, 0.08)


class Numbers:
    """Gives every thing of a city its own instance number, from 1."""

    def __init__(self) -> None:
        self._last = 0

    def next(self) -> int:
        """A number not given before."""
        self._last += 1
        return self._last


@dataclass(slots=True)
class Site:
    """What the builders of one block share."""

    m: MeshBuilder
    shape: BlockShape
    rng: np.random.Generator
    numbers: Numbers
    models: Models


def build_block(site: Site, kind: Kind, clear: list[tuple[float, float]]) -> None:
    """Ground, buildings or park, and what is along the kerbs. clear: for each edge, where its crossings begin, m."""
    count = len(site.shape.nodes)
    for k in range(count):
        ground.half_street(site.m, site.shape, k, clear[k])
        ground.junction(site.m, site.shape, k, clear[k][0], clear[k - 1][1])
        ground.kerb_and_sidewalk(site.m, site.shape, k, bool(site.rng.random() < 0.35))
    square = kind is Kind.SQUARE
    ground.yard(site.m, site.shape, Material.COBBLES if square else Material.LAWN, CLASS_ID["sidewalk" if square else "terrain"])
    {Kind.DENSE: _dense, Kind.GARDENS: _gardens, Kind.PARK: _park, Kind.SQUARE: _square}[kind](site)
    for k in range(count):
        _sidewalk_furniture(site, k, clear[k])
        _parked_vehicles(site, k, clear[k])
        _crossing_furniture(site, k, clear[k])


def _lots(site: Site, k: int, trimmed_m: float) -> list[tuple[F64, F64]]:
    """The back line of sidewalk k cut into lots, leaving trimmed_m free at both ends."""
    a, b = site.shape.inner[k], site.shape.inner[(k + 1) % len(site.shape.inner)]
    length = float(np.hypot(*(b - a)))
    d, s, end, lots = (b - a) / length, trimmed_m, length - trimmed_m, []
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
                buildings.town_house(site.m, Footprint(p + back, q + back, HOUSE_DEPTH_M), floors, site.numbers.next(), site.rng)
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
                buildings.detached_house(site.m, foot, int(site.rng.integers(1, 3)), site.numbers.next(), site.rng)
            _boundary(site, p, q)
            for _ in range(site.rng.integers(0, 3)):
                at = p + d * site.rng.uniform(0.1, 0.9) * width + inward * site.rng.uniform(0.8, garden - 0.8)
                vegetation.bush(site.m, site.rng, at[0], at[1], site.numbers.next(), site.rng.uniform(0.8, 1.6))
            if site.rng.random() < 0.55:
                _tree(site, p + d * side * 0.5 + inward * (garden + 1), site.rng.uniform(0.8, 1.3))


def _boundary(site: Site, p: F64, q: F64) -> None:
    """A hedge, a fence or a wall along the back of the sidewalk."""
    chance, number = site.rng.random(), site.numbers.next()
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
        vegetation.bush(site.m, site.rng, x, y, site.numbers.next(), site.rng.uniform(0.8, 2.0))


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
    buildings.town_house(site.m, Footprint(p, q, HOUSE_DEPTH_M), 2, site.numbers.next(), site.rng)


def _tree(site: Site, at: F64, big: float) -> None:
    """A broad tree, or now and then a conifer."""
    plant = vegetation.conifer if site.rng.random() < 0.14 else vegetation.broadleaf
    plant(site.m, site.rng, at[0], at[1], site.numbers.next(), big)


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
        furniture.lamp_post(site.m, _kerb_point(shape, k, s, 0.45), -inward, site.numbers.next())
    for s in np.arange(first + rng.uniform(6, 9), last, rng.uniform(5.5, 9)):
        at, kind = _kerb_point(shape, k, s, 0.75), rng.choice(len(FURNITURE_SHARES), p=FURNITURE_SHARES)
        if kind == TREE:
            vegetation.broadleaf(site.m, rng, at[0], at[1], site.numbers.next(), rng.uniform(0.8, 1.2))
        elif kind == SIGNPOST:
            furniture.sign_post(site.m, at, d, int(rng.integers(furniture.SIGN_KINDS)), site.numbers.next(), site.numbers.next())
        elif kind == BOLLARDS:
            for step in range(4):
                furniture.bollard(site.m, at + d * 1.3 * step, site.numbers.next())
        elif kind in (BIKES, MOTORBIKES):
            model = site.models.any_bicycle if kind == BIKES else site.models.any_motorcycle
            for step in range(int(rng.integers(1, 4))):
                turn = yaw + np.pi / 2 + rng.normal(0, 0.15)
                x, y = at + d * 0.7 * step
                site.m.add(placed(model(rng), float(x), float(y), turn, KERB_M, site.numbers.next()))
        else:
            furniture.cabinet(site.m, at, yaw, site.numbers.next(), rng)
    if shape.half_m[k] == AVENUE_HALF_M:
        furniture.shelter(site.m, _kerb_point(shape, k, (first + last) / 2, 2.4), d, -inward, site.numbers.next())


def _parked_vehicles(site: Site, k: int, clear: tuple[float, float]) -> None:
    """Vehicles at the kerb, facing as the traffic beside them drives: with the kerb on their right."""
    shape, rng = site.shape, site.rng
    d, _, length = shape.edge(k)
    yaw = float(np.arctan2(-d[1], -d[0]))
    full = rng.uniform(0.35, 0.85)
    s, end = clear[0] + CROSSING_LENGTH_M + 4, length - clear[1] - CROSSING_LENGTH_M - 3
    while s < end:
        chance, needed = rng.random(), rng.uniform(5.4, 6.6)
        if chance < full:
            kind = rng.random()
            if kind < 0.045:
                s, needed = s + 2.0, 8.5
                mesh = site.models.painted(site.models.lorry, rng)
            elif kind < 0.07:
                mesh = site.models.any_motorcycle(rng)
            else:
                mesh = site.models.any_car(rng)
            at = _kerb_point(shape, k, s, -PARKING_FROM_KERB_M + rng.normal(0, 0.06))
            scale = (rng.uniform(0.93, 1.06), rng.uniform(0.97, 1.03), rng.uniform(0.97, 1.06))
            site.m.add(placed(mesh, at[0], at[1], yaw + rng.normal(0, 0.025), 0.0, site.numbers.next(), scale))
        s += needed


def _crossing_furniture(site: Site, k: int, clear: tuple[float, float]) -> None:
    """Traffic lights or signs for those who come along edge k towards its first node, and railings at some corners."""
    shape, rng = site.shape, site.rng
    d, inward, _ = shape.edge(k)
    at = _kerb_point(shape, k, clear[0] + 4.4, 0.55)
    if rng.random() < 0.65:
        arm = 3.8 if shape.half_m[k] == AVENUE_HALF_M or rng.random() < 0.3 else 0.0
        furniture.traffic_light(site.m, at, d, -inward, arm, site.numbers.next(), site.numbers.next())
    else:
        furniture.sign_post(site.m, at, d, int(rng.choice((3, 5, 2))), site.numbers.next(), site.numbers.next())
    furniture.sign_post(site.m, _kerb_point(shape, k, clear[0] + 0.4, 0.6), d, 7, site.numbers.next(), site.numbers.next())
    if rng.random() < 0.4:
        a, b = (_kerb_point(shape, k, clear[0] + s, 0.3) for s in (5.0, 11.0))
        furniture.guard_rail(site.m, a, b, site.numbers.next())


SIDEWALK_MIDDLE_M = SIDEWALK_M * 0.62
"""Where people walk, from the kerb."""
