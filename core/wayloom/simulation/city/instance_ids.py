"""Instance ids of things: 16 bits, computed from the place without a register, equal in all drives of a city.

The blocks of each NUMBERED x NUMBERED have numbers of their own; the pattern repeats beyond, at least 900 m away, farther than
anything is seen. In cities of up to NUMBERED + 1 crossings a side each number belongs to one thing.
"""

from typing import Final

from wayloom.simulation.city.city_settings import CitySettings

UNIQUE_BLOCKS: Final = 16
THINGS_PER_BLOCK, PEOPLE_PER_BLOCK = 208, 40
FIRST_MOVER: Final = 1 + UNIQUE_BLOCKS * UNIQUE_BLOCKS * THINGS_PER_BLOCK
"""Static objects have numbers from 1 on, moving ones from here on: people, then vehicles."""
FIRST_VEHICLE: Final = FIRST_MOVER + UNIQUE_BLOCKS * UNIQUE_BLOCKS * PEOPLE_PER_BLOCK
VEHICLES: Final = 65_536 - FIRST_VEHICLE
"""Number of vehicles that can be told apart at a time."""


def _slot(settings: CitySettings, block: int) -> int:
    row, column = divmod(block, settings.columns - 1)
    return row % UNIQUE_BLOCKS * UNIQUE_BLOCKS + column % UNIQUE_BLOCKS


def first_number(settings: CitySettings, block: int) -> int:
    """First instance number of the static objects of a block; THINGS_PER_BLOCK follow."""
    return 1 + _slot(settings, block) * THINGS_PER_BLOCK


def first_person(settings: CitySettings, block: int) -> int:
    """First instance number of the people around a block; PEOPLE_PER_BLOCK follow."""
    return FIRST_MOVER + _slot(settings, block) * PEOPLE_PER_BLOCK


def vehicle_number(order: int) -> int:
    """Instance number of the vehicle that was created as number `order`."""
    return FIRST_VEHICLE + order % VEHICLES
