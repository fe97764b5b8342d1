"""Sun and sky light: settings, shadow maps, and maps of ambient sky visibility around a place."""

import threading
from collections import OrderedDict
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.simulation.city.city import City
from wayloom.simulation.kernels import shadow
from wayloom.simulation.kernels.arrays import DepthMap, Light, TextureStack, Triangles
from wayloom.simulation.models.mesh import Mesh
from wayloom.simulation.textures.materials import CUTOUTS
from wayloom.simulation.textures.noise import spectral_noise

NEAR_REACH_M, NEAR_TEXELS_PER_M, NEAR_STEP_M = 72.0, 14.0, 24.0
FAR_REACH_M, FAR_TEXELS_PER_M, FAR_STEP_M = 320.0, 3.0, 128.0
OPEN_REACH_M, OPEN_TEXELS_PER_M, OPEN_STEP_M = 84.0, 4.0, 24.0
MOVER_REACH_M, MOVER_TEXELS_PER_M = 45.0, 11.0
CASTER_MARGIN_M = 45.0
"""How far outside a map things may stand that throw a shadow into it."""
NOISE_SIZE = 256
FACETS_SIZE, FACETS_EXPONENT = 256, 1.3
KEPT_MAPS = 4
VERTICAL = np.eye(3, dtype=np.float32)
F32 = NDArray[np.float32]
NO_HEIGHTS: Final = np.zeros((0, 0), np.float32)


class LightSettings(Settings):
    """Time of day and weather. `WEATHERS` holds some that belong together."""

    sun_azimuth_deg: float = Field(
        default=-143.0, ge=-360, le=360, description="direction to the sun, from east towards north, degrees"
    )
    sun_elevation_deg: float = Field(default=46.0, ge=3, le=90, description="degrees above the horizon")
    sun_strength: float = Field(default=2.6, ge=0, le=5, description="radiance of a white surface that faces the sun")
    cloud_cover: float = Field(default=0.5, ge=0, le=1, description="0 clear, 0.5 scattered, 1 overcast")
    haze_per_m: float = Field(default=0.0018, ge=0, le=0.05, description="extinction, 1/m; 0.02 and more is fog")
    wetness: float = Field(default=0.0, ge=0, le=1, description="of the ground: 0 dry, 0.5 damp, 1 pools of water")
    rain_mm_h: float = Field(default=0.0, ge=0, le=50, description="rain in the air, mm an hour")


WEATHERS: Final = {
    "clear": LightSettings(cloud_cover=0.3),
    "noon": LightSettings(sun_azimuth_deg=-90.0, sun_elevation_deg=64.0, sun_strength=3.0, cloud_cover=0.35, haze_per_m=0.001),
    "low sun": LightSettings(sun_azimuth_deg=4.0, sun_elevation_deg=9.0, sun_strength=2.4, cloud_cover=0.3, haze_per_m=0.003),
    "overcast": LightSettings(sun_elevation_deg=50.0, sun_strength=0.25, cloud_cover=1.0, haze_per_m=0.0025),
    "fog": LightSettings(sun_elevation_deg=35.0, sun_strength=0.1, cloud_cover=1.0, haze_per_m=0.022, wetness=0.3),
    "wet road": LightSettings(sun_elevation_deg=22.0, sun_strength=1.6, cloud_cover=0.55, wetness=0.85),
    "rain": LightSettings(
        sun_elevation_deg=45.0, sun_strength=0.12, cloud_cover=1.0, haze_per_m=0.005, wetness=0.95, rain_mm_h=8.0
    ),
}
"""Light by name, for presets and pictures."""


class _Key(NamedTuple):
    kind: str
    column: int
    row: int


class _Square(NamedTuple):
    """A map of one square of the city; the open sky's has the heights (H, W) m of the ground and of what stands on it."""

    values: DepthMap
    ground: F32 = NO_HEIGHTS
    surface: F32 = NO_HEIGHTS


class CityLight:
    """Light of a city: makes the `Light` of each view. Shadow maps belong to squares of the city and are made when first needed."""

    def __init__(self, city: City, textures: TextureStack, settings: LightSettings) -> None:
        self._city, self._textures, self.settings = city, textures, settings
        self._axes = _sun_axes(settings)
        rng = np.random.default_rng([city.seed, 9])
        self._clouds, self._stains = spectral_noise(rng, NOISE_SIZE, 2.6), spectral_noise(rng, NOISE_SIZE, 1.9)
        self._facets = spectral_noise(rng, FACETS_SIZE, FACETS_EXPONENT)
        if city.settings.hard:  # stains lie on the world: they would tell its equal blocks apart
            self._stains = np.zeros_like(self._stains)
        self._maps: OrderedDict[_Key, _Square] = OrderedDict()
        self._lock = threading.Lock()

    def at(self, x: float, y: float, movers: Mesh) -> Light:
        """The light around x, y (m), with the shadows of `movers`. Depends on the arguments alone, not on earlier calls."""
        with self._lock:
            near = self._map("near", x, y, NEAR_STEP_M)
            far = self._map("far", x, y, FAR_STEP_M)
            sky_map = self._map("open", x, y, OPEN_STEP_M)
        s = self.settings
        overcast = s.cloud_cover
        sun = np.array([1.0, 0.93, 0.80], np.float32) * np.float32(s.sun_strength)
        sky = np.array([0.30, 0.43, 0.74], np.float32) * np.float32(1 - 0.5 * overcast) + np.float32(0.5 * overcast) * np.array(
            [0.62, 0.64, 0.68], np.float32
        )
        horizon = np.array([0.74, 0.78, 0.84], np.float32)
        return Light(
            self._axes, near.values, far.values, self._mover_shadow(x, y, movers), sky_map.values, sky_map.ground, sky_map.surface,
            self._clouds, self._stains, self._facets, sun, sky, horizon, s.cloud_cover, s.haze_per_m, s.wetness,
        )  # fmt: skip

    def _map(self, kind: str, x: float, y: float, step_m: float) -> _Square:
        """The map of the square in which x, y lies."""
        key = _Key(kind, int(np.floor(x / step_m)), int(np.floor(y / step_m)))
        if key not in self._maps:
            centre = ((key.column + 0.5) * step_m, (key.row + 0.5) * step_m)
            make = {"near": self._near, "far": self._far, "open": self._open}[kind]
            self._maps[key] = make(*centre)
            while len(self._maps) > 3 * KEPT_MAPS:
                self._maps.popitem(last=False)
        self._maps.move_to_end(key)
        return self._maps[key]

    def _near(self, x: float, y: float) -> _Square:
        return _Square(self._sun_map(x, y, NEAR_REACH_M, NEAR_TEXELS_PER_M))

    def _far(self, x: float, y: float) -> _Square:
        return _Square(self._sun_map(x, y, FAR_REACH_M, FAR_TEXELS_PER_M))

    def _sun_map(self, x: float, y: float, reach_m: float, texels_per_m: float) -> DepthMap:
        casters = self._city.chunks(self._city.around(x, y, reach_m + CASTER_MARGIN_M))
        return _depth_map(casters.triangles(), self._textures, self._axes, self._centre(x, y), reach_m, texels_per_m)

    def _centre(self, x: float, y: float) -> tuple[float, float]:
        p = np.array([x, y, float(self._city.ground.height(np.array(x), np.array(y)))])
        return float(self._axes[0] @ p), float(self._axes[1] @ p)

    def _open(self, x: float, y: float) -> _Square:
        """Share of open sky on the ground, from the heights of everything but leaves; heights of the ground and of all that."""
        near = self._city.chunks(self._city.around(x, y, OPEN_REACH_M))
        solid = near.rows(np.nonzero(~np.isin(near.material, CUTOUTS))[0])
        surface = _depth_map(solid.triangles(), self._textures, VERTICAL, (x, y), OPEN_REACH_M, OPEN_TEXELS_PER_M)
        column = surface.x0 + (np.arange(surface.values.shape[1]) + 0.5) / OPEN_TEXELS_PER_M
        row = surface.y0 + (np.arange(surface.values.shape[0]) + 0.5) / OPEN_TEXELS_PER_M
        ground = self._city.ground.height(column[None, :].astype(float), row[:, None].astype(float)).astype(np.float32)
        openness, top = np.empty_like(ground), np.maximum(surface.values, ground)
        shadow.measure_openness(top, ground, OPEN_TEXELS_PER_M, openness)
        return _Square(DepthMap(openness, surface.x0, surface.y0, OPEN_TEXELS_PER_M), ground, top)

    def _mover_shadow(self, x: float, y: float, movers: Mesh) -> DepthMap:
        return _depth_map(movers.triangles(), self._textures, self._axes, self._centre(x, y), MOVER_REACH_M, MOVER_TEXELS_PER_M)


def _depth_map(
    tri: Triangles,
    textures: TextureStack,
    axes: NDArray[np.float32],
    centre: tuple[float, float],
    reach_m: float,
    texels_per_m: float,
) -> DepthMap:
    """A square map of half edge reach_m around `centre` (coordinates along axes[0] and axes[1])."""
    size = int(2 * reach_m * texels_per_m)
    values = np.full((size, size), shadow.EMPTY_M, np.float32)
    x0, y0 = centre[0] - reach_m, centre[1] - reach_m
    shadow.draw_depth(tri, textures, axes, x0, y0, texels_per_m, values, np.empty((3, 3)))
    return DepthMap(values, x0, y0, texels_per_m)


def _sun_axes(settings: LightSettings) -> NDArray[np.float32]:
    """(3, 3): two directions across the rays, and the direction to the sun."""
    azimuth, elevation = np.radians(settings.sun_azimuth_deg), np.radians(settings.sun_elevation_deg)
    sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([across, np.cross(sun, across), sun]).astype(np.float32)
