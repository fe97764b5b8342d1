"""A small city that all tests of the simulation share."""

import numpy as np
import pytest

from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.presets import DrivePlan, Preset
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.vehicle.rigs import camera_on_ground
from wayloom.simulation.vehicle.vehicle_settings import SensorSettings, VehicleSettings

CITY = CitySettings(seed=11, columns=4, rows=4)


@pytest.fixture(scope="session")
def world() -> World:
    """A city of 4 x 4 crossings with coarse textures."""
    return build_world(CITY, LightSettings(), "quarter")


@pytest.fixture(scope="session")
def poses(world: World) -> list[np.ndarray]:
    """T_world_cam at three places of the middle streets, both directions."""
    nodes = world.city.graph.nodes
    out = []
    for a, b in ((5, 6), (6, 10), (10, 9)):
        d = nodes[b] - nodes[a]
        d = d / np.hypot(*d)
        x, y = nodes[a] + 12.0 * d + 1.9 * np.array([d[1], -d[0]])
        out.append(camera_on_ground(float(x), float(y), float(np.arctan2(d[1], d[0])), 3.0))
    return out


@pytest.fixture(scope="session")
def short_preset() -> Preset:
    """Two drives of five frames."""
    plan = DrivePlan(vehicle_id="one", nodes=(4, 5, 6, 10), reference=2, before_m=25.0, frames=5, start_s=7.0)
    right = VehicleSettings(right=SensorSettings(gain=1.03))
    other = plan.model_copy(update={"vehicle_id": "two", "nodes": (7, 6, 5, 4), "start_s": 90.0, "vehicle": right})
    return Preset(name="short", about="for tests", city=CITY, drives=(plan, other))
