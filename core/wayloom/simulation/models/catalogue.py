"""Catalogue of vehicle and pedestrian models, each built once and instanced by the city and its traffic."""

from dataclasses import dataclass, field

import numpy as np

from wayloom.simulation.models import two_wheelers, vehicles
from wayloom.simulation.models.mesh import Mesh, join, recoloured
from wayloom.simulation.models.people import STEP_PHASES, biker, cyclist, pedestrian

WALKERS, RIDERS = 10, 5
TRAM_SECTION_M = 9.0
MOTORCYCLE_SHARES = (0.5, 0.25, 0.25)
"""Of bare ones, touring ones and scooters."""
MOTORCYCLE_COLOURS = (
    (0.02, 0.02, 0.022), (0.05, 0.05, 0.055), (0.45, 0.03, 0.02), (0.03, 0.07, 0.28), (0.55, 0.56, 0.57), (0.02, 0.02, 0.022),
    (0.75, 0.74, 0.70), (0.10, 0.13, 0.10), (0.55, 0.20, 0.03),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Models:
    """Meshes of the vehicles and people around their own origins. walkers: one mesh for each person and phase of the step."""

    cars: tuple[Mesh, ...] = field(default_factory=lambda: tuple(vehicles.car(p) for p in vehicles.CAR_PROFILES))
    lorry: Mesh = field(default_factory=vehicles.lorry)
    bus: Mesh = field(default_factory=vehicles.bus)
    tram: Mesh = field(default_factory=lambda: vehicles.bus(2 * TRAM_SECTION_M, "train"))
    bicycle: Mesh = field(default_factory=two_wheelers.bicycle)
    motorcycles: tuple[Mesh, ...] = field(
        default_factory=lambda: (two_wheelers.motorcycle(), two_wheelers.motorcycle(touring=True), two_wheelers.scooter())
    )
    walkers: tuple[tuple[Mesh, ...], ...] = field(default_factory=lambda: tuple(_walker(k) for k in range(WALKERS)))
    cyclists: tuple[Mesh, ...] = field(
        default_factory=lambda: tuple(cyclist(np.random.default_rng([2, k]), k % 2 == 0) for k in range(RIDERS))
    )
    bikers: tuple[Mesh, ...] = field(default_factory=lambda: tuple(biker(np.random.default_rng([3, k])) for k in range(RIDERS)))

    def any_car(self, rng: np.random.Generator) -> Mesh:
        """A car of random shape and colour."""
        shape = self.cars[rng.choice(len(self.cars), p=(0.34, 0.26, 0.25, 0.15))]
        return recoloured(shape, vehicles.PAINTWORK, vehicles.CAR_COLOURS[rng.integers(len(vehicles.CAR_COLOURS))])

    def any_bicycle(self, rng: np.random.Generator) -> Mesh:
        """A bicycle of random colour."""
        return recoloured(self.bicycle, vehicles.PAINTWORK, rng.uniform(0.02, 0.45, 3))

    def any_motorcycle(self, rng: np.random.Generator) -> Mesh:
        """A motorcycle or scooter of random colour."""
        shape = self.motorcycles[rng.choice(len(self.motorcycles), p=MOTORCYCLE_SHARES)]
        return recoloured(shape, vehicles.PAINTWORK, MOTORCYCLE_COLOURS[rng.integers(len(MOTORCYCLE_COLOURS))])

    def any_cyclist(self, rng: np.random.Generator) -> Mesh:
        """A bicycle with its rider."""
        return join([self.any_bicycle(rng), self.cyclists[rng.integers(RIDERS)]])

    def any_biker(self, rng: np.random.Generator) -> Mesh:
        """A motorcycle with its rider."""
        return join([self.any_motorcycle(rng), self.bikers[rng.integers(RIDERS)]])

    def painted(self, mesh: Mesh, rng: np.random.Generator) -> Mesh:
        """A lorry, bus or tram in a random company colour."""
        return recoloured(
            mesh, vehicles.PAINTWORK, ((0.6, 0.08, 0.05), (0.7, 0.5, 0.05), (0.06, 0.15, 0.4), (0.65, 0.65, 0.62))[rng.integers(4)]
        )


def _walker(k: int) -> tuple[Mesh, ...]:
    """One person in every phase of the step."""
    return tuple(pedestrian(np.random.default_rng([1, k]), phase / STEP_PHASES) for phase in range(STEP_PHASES))
