"""The vehicles and people that a city is filled from, each modelled once."""

from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation import vehicles
from wayloom.simulation.mesh import Mesh, join, recoloured
from wayloom.simulation.people import STEP_PHASES, pedestrian, rider

WALKERS, RIDERS = 10, 5
TRAM_SECTION_M = 9.0


@dataclass(frozen=True, slots=True)
class Models:
    """Meshes around their own origins. walkers: for each person one mesh a phase of the step."""

    cars: tuple[Mesh, ...] = field(default_factory=lambda: tuple(vehicles.car(p) for p in vehicles.CAR_PROFILES))
    lorry: Mesh = field(default_factory=vehicles.lorry)
    bus: Mesh = field(default_factory=vehicles.bus)
    tram: Mesh = field(default_factory=lambda: vehicles.bus(2 * TRAM_SECTION_M, "train"))
    bicycle: Mesh = field(default_factory=vehicles.bicycle)
    motorcycle: Mesh = field(default_factory=vehicles.motorcycle)
    walkers: tuple[tuple[Mesh, ...], ...] = field(default_factory=lambda: tuple(_walker(k) for k in range(WALKERS)))
    cyclists: tuple[Mesh, ...] = field(
        default_factory=lambda: tuple(rider(np.random.default_rng([2, k]), 0.22, 0.92, k % 2 == 0) for k in range(RIDERS))
    )
    bikers: tuple[Mesh, ...] = field(
        default_factory=lambda: tuple(rider(np.random.default_rng([3, k]), 0.12, 0.80, True) for k in range(RIDERS))
    )

    def any_car(self, rng: np.random.Generator) -> Mesh:
        """A car of random shape and colour."""
        shape = self.cars[rng.choice(len(self.cars), p=(0.34, 0.26, 0.25, 0.15))]
        return recoloured(shape, vehicles.PAINTWORK, vehicles.CAR_COLOURS[rng.integers(len(vehicles.CAR_COLOURS))])

    def any_bicycle(self, rng: np.random.Generator) -> Mesh:
        """A bicycle of random colour."""
        return recoloured(self.bicycle, vehicles.PAINTWORK, rng.uniform(0.02, 0.45, 3))

    def any_motorcycle(self, rng: np.random.Generator) -> Mesh:
        """A motorcycle of random colour."""
        return recoloured(self.motorcycle, vehicles.PAINTWORK, rng.uniform(0.02, 0.45, 3))

    def any_cyclist(self, rng: np.random.Generator) -> Mesh:
        """A bicycle with its rider."""
        return join([self.any_bicycle(rng), self.cyclists[rng.integers(RIDERS)]])

    def any_biker(self, rng: np.random.Generator) -> Mesh:
        """A motorcycle with its rider."""
        return join([self.any_motorcycle(rng), self.bikers[rng.integers(RIDERS)]])

    def painted(self, mesh: Mesh, rng: np.random.Generator) -> Mesh:
        """A lorry, bus or tram in a company's colour."""
        return recoloured(
            mesh, vehicles.PAINTWORK, ((0.6, 0.08, 0.05), (0.7, 0.5, 0.05), (0.06, 0.15, 0.4), (0.65, 0.65, 0.62))[rng.integers(4)]
        )


def _walker(k: int) -> tuple[Mesh, ...]:
    """One person in every phase of the step."""
    return tuple(pedestrian(np.random.default_rng([1, k]), phase / STEP_PHASES) for phase in range(STEP_PHASES))
