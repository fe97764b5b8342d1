"""What moves: vehicles on their lanes, people on the sidewalks. All of it is a function of the time."""

from dataclasses import dataclass

import numpy as np

from wayloom.simulation import terrain
from wayloom.simulation.blocks import SIDEWALK_MIDDLE_M
from wayloom.simulation.city import MOST_THINGS, City
from wayloom.simulation.ground import KERB_M
from wayloom.simulation.mesh import Mesh, posed
from wayloom.simulation.models import WALKERS, Models
from wayloom.simulation.paths import AVENUE_LANE_M, CYCLE_LANE_M, LANE_M, TRAM_LANE_M, Path, lane_path
from wayloom.simulation.people import STEP_PHASES
from wayloom.simulation.streets import F64, block_shape, inset

FIRST_MOVER = MOST_THINGS
"""Instance number of the first moving thing; standing things stay below."""
SEEN_FROM_M, PERSON_SEEN_FROM_M = 200.0, 100.0
TALLEST_M, PERSON_REACH_M = 3.8, 0.5
STRIDE_M = 1.45
GAP_M = {"car": (28.0, 60.0), "cycle": (70.0, 140.0), "tram": (180.0, 260.0), "walk": (14.0, 40.0)}
SPEED_M_S = {"car": (8.0, 11.0), "cycle": (4.0, 5.5), "tram": (7.0, 9.0), "walk": (1.0, 1.6)}


@dataclass(frozen=True, slots=True)
class Mover:
    """One moving thing. frames: its mesh, or one for each phase of the step; reach_m: half its length."""

    frames: tuple[Mesh, ...]
    path: Path
    start_m: float
    speed_m_s: float
    lift_m: float
    reach_m: float

    def at(self, t_s: float) -> tuple[float, float, float]:
        """x, y, yaw at a time, s. At the end of the path it begins again."""
        return self.path.at(self._s(t_s))

    def mesh(self, t_s: float) -> Mesh:
        """The mesh for a time."""
        return self.frames[int(self._s(t_s) / STRIDE_M * STEP_PHASES) % len(self.frames)]

    def _s(self, t_s: float) -> float:
        return (self.start_m + self.speed_m_s * t_s) % self.path.length_m


@dataclass(frozen=True, slots=True)
class Placed:
    """A mover at one moment: its mesh, and a ball of radius_m around centre (3,) m that holds it."""

    mesh: Mesh
    centre: F64
    radius_m: float


class Traffic:
    """All movers of a city."""

    def __init__(self, movers: list[Mover]) -> None:
        self.movers = movers
        self._reach_m = np.array([m.reach_m for m in movers])
        self._seen_from_m = np.where(self._reach_m > PERSON_REACH_M, SEEN_FROM_M, PERSON_SEEN_FROM_M)
        lanes: dict[int, list[int]] = {}
        for index, mover in enumerate(movers):
            lanes.setdefault(id(mover.path), []).append(index)
        self._lanes = [(movers[rows[0]].path, np.array(rows)) for rows in lanes.values()]
        self._start_m, self._speed_m_s = np.array([m.start_m for m in movers]), np.array([m.speed_m_s for m in movers])

    def places(self, t_s: float) -> F64:
        """(M, 2) x, y m of all movers at a time, s."""
        out = np.empty((len(self.movers), 2))
        for path, rows in self._lanes:
            s = (self._start_m[rows] + self._speed_m_s[rows] * t_s) % path.length_m
            out[rows, 0], out[rows, 1] = np.interp(s, path.s, path.xy[:, 0]), np.interp(s, path.s, path.xy[:, 1])
        return out

    def meeting(self, x: F64, y: F64, t_s: F64, clearance_m: float) -> frozenset[int]:
        """Which movers come within clearance_m (and half their length) of a vehicle at x, y (N,) m at times t_s (N,)."""
        gap = np.min([np.hypot(*(self.places(float(t)) - (px, py)).T) for px, py, t in zip(x, y, t_s, strict=True)], axis=0)
        return frozenset(np.nonzero(gap < clearance_m + self._reach_m)[0].tolist())

    def around(self, x: float, y: float, t_s: float, left_out: frozenset[int] = frozenset()) -> list[Placed]:
        """The movers near x, y (m) at a time, except those left out."""
        out = []
        for index in np.nonzero(np.hypot(*(self.places(t_s) - (x, y)).T) < self._seen_from_m)[0].tolist():
            if index not in left_out:
                mover = self.movers[index]
                pose = terrain.pose_on_ground(*mover.at(t_s))
                pose[2, 3] += mover.lift_m
                out.append(Placed(posed(mover.mesh(t_s), pose, FIRST_MOVER + index), pose[:3, 3], mover.reach_m + TALLEST_M))
        return out


def build_traffic(city: City, models: Models) -> Traffic:
    """Vehicles on both lanes of every line of streets, trams on the avenues, people around every block."""
    columns, rows, density = city.settings.columns, city.settings.rows, city.settings.traffic
    people = city.settings.people
    rng = np.random.default_rng([city.seed, 5])
    movers: list[Mover] = []
    for chain in _lines(columns, rows):
        avenue = city.graph.street(chain[0], chain[1]).is_avenue
        for direction in (chain, chain[::-1]):
            nodes = city.graph.nodes[list(direction)]
            _fill(movers, rng, lane_path(nodes, AVENUE_LANE_M if avenue else LANE_M), "car", density, models)
            _fill(movers, rng, lane_path(nodes, CYCLE_LANE_M + (AVENUE_LANE_M - LANE_M if avenue else 0)), "cycle", density, models)
            if avenue:
                _fill(movers, rng, lane_path(nodes, TRAM_LANE_M), "tram", density, models)
    for loop in city.graph.blocks:
        shape = block_shape(city.graph, loop)
        line = inset(shape.kerb, np.full(len(loop), SIDEWALK_MIDDLE_M))
        line = line if rng.random() < 0.5 else line[::-1]
        _fill(movers, rng, lane_path(line, 0.0, 2.0, closed=True), "walk", people, models)
    return Traffic(movers)


def _lines(columns: int, rows: int) -> list[list[int]]:
    """Node chains of the rows and columns within the city; the outermost streets, half of them meadow, stay empty."""
    across = [[r * columns + c for c in range(columns)] for r in range(1, rows - 1)]
    return across + [[r * columns + c for r in range(rows)] for c in range(1, columns - 1)]


def _fill(movers: list[Mover], rng: np.random.Generator, path: Path, kind: str, density: float, models: Models) -> None:
    """Movers of one kind along a path, all at one speed, so that none runs into the next."""
    speed, s = rng.uniform(*SPEED_M_S[kind]), rng.uniform(0, GAP_M[kind][0])
    while density > 0 and s < path.length_m - GAP_M[kind][0] / 2:
        frames, reach = _choose(kind, rng, models)
        movers.append(Mover(frames, path, s, speed, KERB_M if kind == "walk" else 0.0, reach))
        s += rng.uniform(*GAP_M[kind]) / density


def _choose(kind: str, rng: np.random.Generator, models: Models) -> tuple[tuple[Mesh, ...], float]:
    """Frames and half length m of a random mover of one kind."""
    if kind == "walk":
        return models.walkers[rng.integers(WALKERS)], 0.4
    if kind == "cycle":
        return (models.any_cyclist(rng),), 0.9
    if kind == "tram":
        return (models.painted(models.tram, rng),), 9.0
    chance = rng.random()
    if chance < 0.07:
        return (models.painted(models.bus, rng),), 5.8
    if chance < 0.14:
        return (models.painted(models.lorry, rng),), 3.7
    if chance < 0.24:
        return (models.any_biker(rng),), 1.1
    return (models.any_car(rng),), 2.3
