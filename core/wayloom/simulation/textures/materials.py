"""Material indices of the texture stack, with their relief, roughness and emission."""

from enum import IntEnum, auto
from typing import Final

import numpy as np


class Material(IntEnum):
    """Index into the texture stack. What a repeat spans in metres is set where the surface is built."""

    STREET = 0
    AVENUE = auto()
    ASPHALT = auto()
    CROSSING = auto()
    PAVERS = auto()
    COBBLES = auto()
    LAWN = auto()
    SOIL = auto()
    PLASTER_CREAM = auto()
    CLINKER = auto()
    PLASTER_GREY = auto()
    PLASTER_OCHRE = auto()
    PANELS = auto()
    PLASTER_WHITE = auto()
    SANDSTONE = auto()
    SHOP = auto()
    DOOR = auto()
    ROOF_TILES = auto()
    BRICK = auto()
    RUBBLE = auto()
    CONCRETE = auto()
    BARK = auto()
    LEAVES = auto()
    NEEDLES = auto()
    HEDGE = auto()
    RAILS = auto()
    PICKETS = auto()
    MESH = auto()
    METAL = auto()
    PAINT = auto()
    GLASS = auto()
    WHEEL = auto()
    SPOKES = auto()
    SIGNS = auto()
    LAMPS = auto()
    BUS_SIDE = auto()
    CLOTH = auto()
    LIT = auto()
    CAR_SIDE = auto()
    CAR_BACK = auto()
    CAR_FRONT = auto()
    TRUCK_SIDE = auto()
    TRUCK_BACK = auto()
    CAB_FRONT = auto()
    BUS_FRONT = auto()
    BUS_BACK = auto()
    TRAM_SIDE = auto()
    JACKET = auto()


FACADES: Final = (
    Material.PLASTER_CREAM,
    Material.CLINKER,
    Material.PLASTER_GREY,
    Material.PLASTER_OCHRE,
    Material.PANELS,
    Material.PLASTER_WHITE,
    Material.SANDSTONE,
)
CUTOUTS: Final = (
    Material.LEAVES,
    Material.NEEDLES,
    Material.RAILS,
    Material.PICKETS,
    Material.MESH,
    Material.SPOKES,
    Material.SIGNS,
)
SMOOTH: Final = (
    Material.RAILS,
    Material.PICKETS,
    Material.MESH,
    Material.SPOKES,
    Material.SIGNS,
    Material.PAINT,
    Material.GLASS,
    Material.WHEEL,
    Material.LAMPS,
    Material.BUS_SIDE,
    Material.CLOTH,
    Material.LIT,
    Material.CAR_SIDE,
    Material.CAR_BACK,
    Material.CAR_FRONT,
    Material.TRUCK_SIDE,
    Material.TRUCK_BACK,
    Material.CAB_FRONT,
    Material.BUS_FRONT,
    Material.BUS_BACK,
    Material.TRAM_SIDE,
    Material.JACKET,
)
"""Manufactured things: no large-scale stains. A cut-out that is not smooth is a leaf and lets light through."""


ROUGH: Final = {
    Material.STREET: 0.13,
    Material.AVENUE: 0.13,
    Material.ASPHALT: 0.13,
    Material.CROSSING: 0.13,
    Material.PAVERS: 0.12,
    Material.COBBLES: 0.2,
    Material.LAWN: 0.22,
    Material.SOIL: 0.2,
    Material.CLINKER: 0.12,
    Material.SANDSTONE: 0.12,
    Material.ROOF_TILES: 0.15,
    Material.BRICK: 0.15,
    Material.RUBBLE: 0.2,
    Material.CONCRETE: 0.1,
    Material.BARK: 0.2,
    Material.LEAVES: 0.22,
    Material.NEEDLES: 0.22,
    Material.HEDGE: 0.22,
}
"""Spread of what a surface throws towards a viewer, as a share. Other rough surfaces have PLASTER_RELIEF, smooth ones none."""
PLASTER_RELIEF = 0.08
GLOWING: Final = {Material.LAMPS: 1.0, Material.LIT: 1.0}
"""What gives light of itself: the bright parts of signals, and lit lamps."""


def reliefs() -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """(L,) float32: each material's relief."""
    return np.array([0.0 if m in SMOOTH else ROUGH.get(m, PLASTER_RELIEF) for m in Material], np.float32)


def glows() -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """(L,) float32: each material's own light."""
    return np.array([GLOWING.get(m, 0.0) for m in Material], np.float32)


def flags(members: tuple[Material, ...]) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """(L,) uint8: 1 for the materials named."""
    out = np.zeros(len(Material), np.uint8)
    out[list(members)] = 1
    return out
