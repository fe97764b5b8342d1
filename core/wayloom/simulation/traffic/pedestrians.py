"""Pedestrian traffic on sidewalks and squares: walkers on closed paths at constant speed."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from wayloom.simulation.city.blocks import LandUse, land_use
from wayloom.simulation.city.city import City
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.instance_ids import PEOPLE_PER_BLOCK, first_person
from wayloom.simulation.city.paths import Path, lane_path
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.catalogue import WALKERS
from wayloom.simulation.models.mesh import Mesh
from wayloom.simulation.models.people import STEP_PHASES

LINES_M = (2.05, 2.8)
"""How far from the kerb one walks in either direction, clear of trees, poles and doorsteps."""
STRIDE_M = 1.45
GAP_M, SPEED_M_S = (16.0, 60.0), (1.0, 1.6)
CLOSEST_M = 1.2
SQUARE_SHARE = 0.58
CORNER_M = 0.5
KEPT_BLOCKS = 256


@dataclass(frozen=True, slots=True)
class Walker:
    """One person. frames: a mesh for each phase of the step."""

    number: int
    frames: tuple[Mesh, ...]
    path: Path
    start_m: float
    speed_m_s: float
    lift_m: float

    def at(self, t_s: float) -> tuple[float, float, float]:
        """x, y m and yaw rad."""
        return self.path.at(self._s(t_s))

    def mesh(self, t_s: float) -> Mesh:
        """The mesh of the phase at a time."""
        return self.frames[int(self._s(t_s) / STRIDE_M * STEP_PHASES) % len(self.frames)]

    def _s(self, t_s: float) -> float:
        return (self.start_m + self.speed_m_s * t_s) % self.path.length_m


class People:
    """Pedestrians of a city, generated lazily block by block."""

    def __init__(self, city: City) -> None:
        self._city = city
        self.of_block = lru_cache(KEPT_BLOCKS)(self._of_block)

    def around(self, x: float, y: float, reach_m: float) -> list[Walker]:
        """Pedestrians of the blocks that a square of half edge reach_m around x, y touches."""
        here = np.array([x, y])
        blocks = self._city.graph.blocks_within(here - reach_m, here + reach_m)
        return [walker for block in blocks for walker in self.of_block(block)]

    def _of_block(self, block: int) -> list[Walker]:
        settings, shape = self._city.settings, self._city.graph.shape(block)
        rng = np.random.default_rng([settings.seed, 6, 0 if settings.hard else block])
        kerb = shape.kerb_line()
        lines = [lane_path(kerb, -LINES_M[0], CORNER_M, closed=True), lane_path(kerb[::-1], LINES_M[1], CORNER_M, closed=True)]
        if land_use(settings, block) is LandUse.SQUARE:
            middle = shape.inner.mean(axis=0)
            lines.append(lane_path(middle + SQUARE_SHARE * (shape.inner - middle), 0.0, 6.0, closed=True))
        out: list[Walker] = []
        for path in lines if settings.people > 0 else ():
            out += self._line(path, rng, first_person(settings, block) + len(out), PEOPLE_PER_BLOCK - len(out))
        return out

    def _line(self, path: Path, rng: np.random.Generator, number: int, most: int) -> list[Walker]:
        """People along one line, far enough apart."""
        speed, s = float(rng.uniform(*SPEED_M_S)), float(rng.uniform(0, GAP_M[1]))
        out: list[Walker] = []
        while s < path.length_m - CLOSEST_M and len(out) < most:
            frames = self._city.models.walkers[rng.integers(WALKERS)]
            out.append(Walker(number + len(out), frames, path, s, speed, KERB_M))
            s += max(CLOSEST_M, float(rng.uniform(*GAP_M)) / self._city.settings.people)
        return out


def places(walkers: list[Walker], t_s: float) -> F64:
    """(N, 2) m."""
    return np.array([walker.at(t_s)[:2] for walker in walkers]).reshape(-1, 2)
