"""A whole world from a seed."""

from wayloom.simulation.city import build_city
from wayloom.simulation.light import CityLight, LightSettings
from wayloom.simulation.models import Models
from wayloom.simulation.renderer import World
from wayloom.simulation.textures import paint_textures
from wayloom.simulation.traffic import build_traffic

TEXTURE_PX = {"full": 1024, "half": 512, "quarter": 256}
"""Edge of the textures for each image size."""


def build_world(seed: int, columns: int, rows: int, light: LightSettings, size: str, density: float = 1.0) -> World:
    """City, traffic, textures and light. Equal arguments give equal worlds."""
    models = Models()
    city = build_city(seed, columns, rows, models)
    textures = paint_textures(seed, TEXTURE_PX[size])
    return World(city, build_traffic(city, columns, rows, models, density), textures, CityLight(city, textures, light))
