"""The layers of the texture stack: one material each."""

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
)
"""Manufactured things: no large-scale stains. A cut-out that is not smooth is a leaf and lets light through."""


def flags(members: tuple[Material, ...]) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """(L,) uint8: 1 for the materials named."""
    out = np.zeros(len(Material), np.uint8)
    out[list(members)] = 1
    return out
