"""What `wayloom simulate` can drive: a city, its light, and the vehicles' routes."""

from typing import Final

from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.errors import ConfigError
from wayloom.georeference.types import MapFrame
from wayloom.logs.types import FixType
from wayloom.simulation.gnss import FixPlan
from wayloom.simulation.light import LightSettings

CITY_ORIGIN: Final = MapFrame(lon_deg=3.52, lat_deg=55.49, height_m=45.0)
"""Where the city's zero lies on Earth: over the Dogger Bank in the North Sea, so that nobody takes it for a real place."""
START_NS: Final = 1_780_300_800_000_000_000
"""The city's time zero: 2026-06-01 08:00 UTC."""


class DrivePlan(Settings):
    """One drive of one vehicle."""

    vehicle_id: str
    nodes: tuple[int, ...] = Field(min_length=2, description="crossings passed, row * columns + column")
    reference: int = Field(description="place in `nodes` of the crossing from which the start is measured")
    before_m: float = Field(description="start this far before that crossing, m along the lane")
    frames: int = Field(ge=2, le=100_000)
    start_s: float = Field(ge=0, description="s after the city's time zero")
    fastest_m_s: float = Field(default=12.5, gt=0, le=40)
    gnss: tuple[tuple[float, FixType], ...] = ((0.0, FixType.FIXED),)
    p_cam_gnss_m: tuple[float, float, float] = (0.05, -0.55, -0.90)
    right_gain: float = Field(default=1.0, gt=0.5, lt=2, description="sensitivity of the right camera, left is 1")

    @property
    def fix_plan(self) -> FixPlan:
        """The fixes over the drive."""
        return FixPlan(self.gnss)


class Preset(Settings):
    """A city and the drives in it."""

    name: str
    about: str
    seed: int = Field(ge=0)
    columns: int = Field(default=5, ge=3, le=200)
    rows: int = Field(default=5, ge=3, le=200)
    rate_hz: float = Field(default=10.0, gt=0, le=100)
    traffic: float = Field(default=1.0, ge=0, le=3, description="density of moving things")
    light: LightSettings = LightSettings()
    drives: tuple[DrivePlan, ...]


DEMO: Final = Preset(
    name="demo",
    about="Two vehicles in the same streets: one turns a corner, the other comes the opposite way and goes straight on.",
    seed=7,
    drives=(
        DrivePlan(vehicle_id="car-1", nodes=(5, 6, 7, 12), reference=2, before_m=58.0, frames=72, start_s=12.0),
        DrivePlan(
            vehicle_id="car-2",
            nodes=(9, 8, 7, 6, 5),
            reference=2,
            before_m=26.0,
            frames=72,
            start_s=400.0,
            gnss=((0.0, FixType.FIXED), (0.40, FixType.FLOAT), (0.50, FixType.NONE), (0.62, FixType.SINGLE), (0.72, FixType.FIXED)),
            p_cam_gnss_m=(-0.20, -0.48, -1.25),
            right_gain=1.02,
        ),
    ),
)
PRESETS: Final = {preset.name: preset for preset in (DEMO,)}


def find_preset(name: str) -> Preset:
    """The preset of that name. Raises ConfigError that lists the known ones."""
    if name not in PRESETS:
        raise ConfigError(f"unknown preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}")
    return PRESETS[name]
