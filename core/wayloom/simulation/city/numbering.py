"""Instance ids of things: 16 bits, computed from the place without a register, equal in all drives of a city.

The blocks of each NUMBERED x NUMBERED have numbers of their own; the pattern repeats beyond, at least 900 m away, farther than
anything is seen. In cities of up to NUMBERED + 1 crossings a side each number belongs to one thing.
"""

from typing import Final

from wayloom.simulation.city.city_settings import CitySettings

NUMBERED: Final = 16
THINGS_PER_BLOCK, PEOPLE_PER_BLOCK = 208, 40
FIRST_MOVER: Final = 1 + NUMBERED * NUMBERED * THINGS_PER_BLOCK
"""Standing things have numbers from 1, what moves from here on: people, then vehicles."""
FIRST_VEHICLE: Final = FIRST_MOVER + NUMBERED * NUMBERED * PEOPLE_PER_BLOCK
VEHICLES: Final = 65_536 - FIRST_VEHICLE
"""So many vehicles can be told apart at a time."""


def _slot(settings: CitySettings, block: int) -> int:
    row, column = divmod(block, settings.columns - 1)
    return row % NUMBERED * NUMBERED + column % NUMBERED


def first_number(settings: CitySettings, block: int) -> int:
    """Of the standing things of a block; THINGS_PER_BLOCK follow."""
    return 1 + _slot(settings, block) * THINGS_PER_BLOCK


def first_person(settings: CitySettings, block: int) -> int:
    """Of the people around a block; PEOPLE_PER_BLOCK follow."""
    return FIRST_MOVER + _slot(settings, block) * PEOPLE_PER_BLOCK


def vehicle_number(order: int) -> int:
    """Of the vehicle that began as number `order`."""
    return FIRST_VEHICLE + order % VEHICLES
