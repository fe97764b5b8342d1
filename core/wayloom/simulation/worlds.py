"""A whole world from its settings."""

from wayloom.simulation.city import build_city
from wayloom.simulation.city_settings import CitySettings
from wayloom.simulation.light import CityLight, LightSettings
from wayloom.simulation.models import Models
from wayloom.simulation.renderer import World
from wayloom.simulation.textures import paint_textures
from wayloom.simulation.traffic import build_traffic

TEXTURE_PX = {"full": 1024, "half": 512, "quarter": 256}
"""Edge of the textures for each image size."""


def build_world(city: CitySettings, light: LightSettings, size: str) -> World:
    """City, traffic, textures and light. Equal arguments give equal worlds."""
    models = Models()
    built = build_city(city, models)
    textures = paint_textures(city.seed, TEXTURE_PX[size])
    return World(built, build_traffic(built, models), textures, CityLight(built, textures, light))
