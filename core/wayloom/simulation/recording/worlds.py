"""World construction from settings: city, textures, light and background traffic."""

from wayloom.simulation.city.city import build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.rendering.light import CityLight, LightSettings
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.textures.texture_stack import paint_textures
from wayloom.simulation.traffic.population import BackgroundTraffic
from wayloom.simulation.traffic.traffic import Traffic

TEXTURE_PX = {"full": 1024, "half": 512, "quarter": 256}
"""Edge of the textures for each image size."""


def build_world(city: CitySettings, light: LightSettings, size: str) -> World:
    """City, textures, light, and the traffic around the city's middle, for pictures without a drive (`drives` make their own).

    Equal arguments give equal worlds.
    """
    built = build_city(city, Models())
    textures = paint_textures(city.seed, TEXTURE_PX[size])
    return World(built, Traffic(built, BackgroundTraffic(built)), textures, CityLight(built, textures, light))
