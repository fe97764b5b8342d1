"""Labelled views from random places of many cities: training images for networks, and samples to compare with photographs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.paths import AVENUE_LANE_M, LANE_M
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings
from wayloom.simulation.rendering.renderer import Scene, Truth, World
from wayloom.simulation.sensors.camera import developed, exposed, metered_gain
from wayloom.simulation.sensors.optics import through_lens, true_cameras, truth_of
from wayloom.simulation.vehicle.rigs import camera_on_ground, given_rig, sized_rig
from wayloom.simulation.vehicle.vehicle_settings import RightLensSettings, SensorSettings, VehicleSettings

CITY_COLUMNS, CITY_ROWS = 5, 5
FIRST_TRAINING_SEED = 1000
"""Training cities have seeds from here on; those of the presets that are driven and judged lie below."""
WET_SHARE, RAIN_SHARE, FOG_SHARE = 0.15, 0.06, 0.05
EVERYDAY: Final = VehicleSettings(
    right=SensorSettings(gain=1.02, offset=2.0, gamma_ratio=1.02, vignette=0.42, vignette_centre=(0.05, -0.03), blur_px=0.55),
    right_lens=RightLensSettings(pitch_rad=0.0007, roll_rad=0.0006, cx_shift_px=0.3, k1=0.0012, p1=0.0004, p2=-0.0003),
)
"""A pair as real ones are: two lenses and two sensors that differ a little, and a calibration that is a little wrong."""


def random_light(rng: np.random.Generator) -> LightSettings:
    """Any time of day from early morning on, clear to overcast; sometimes on a wet road, seldom in rain or fog."""
    overcast = float(rng.beta(1.2, 1.2))
    wetness, rain_mm_h, haze_per_m = 0.0, 0.0, float(rng.uniform(0.0008, 0.005))
    what = rng.random()
    if what < WET_SHARE:
        wetness = float(rng.uniform(0.3, 1.0))
    if what < RAIN_SHARE:
        rain_mm_h, overcast = float(rng.uniform(0.5, 10.0)), 1.0
    elif what > 1 - FOG_SHARE:
        haze_per_m, overcast = float(rng.uniform(0.008, 0.025)), 1.0
    return LightSettings(
        sun_azimuth_deg=float(rng.uniform(-180, 180)),
        sun_elevation_deg=float(rng.uniform(9, 68)),
        sun_strength=float(rng.uniform(2.0, 3.2) * (1 - 0.93 * max(0.0, overcast - 0.45) / 0.55)),
        cloud_cover=overcast,
        haze_per_m=haze_per_m,
        wetness=wetness,
        rain_mm_h=rain_mm_h,
    )


@dataclass(frozen=True, slots=True)
class StereoView:
    """left, right (h, w, 3) uint8 RGB, and the left image's truth."""

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth: Truth


def render_views(
    seed: int, count: int, size: str = "half", rng: np.random.Generator | None = None
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """`count` views of the city of `seed` (use FIRST_TRAINING_SEED and above): (h, w, 3) uint8 RGB, (h, w) uint8 train ids.

    Places, headings and moments are drawn from rng (default: seeded by `seed`); sun and weather are one draw a call.
    Both directions of every street, small offsets in the lane, a few views across the street at crossings.
    """
    rng = rng or np.random.default_rng([seed, 77])
    world = build_world(CitySettings(seed=seed, columns=CITY_COLUMNS, rows=CITY_ROWS), random_light(rng), size)
    camera = sized_rig(size).camera
    for _ in range(count):
        scene, T_world_cam = _random_scene(world, size, rng)
        radiance = scene.image(camera, T_world_cam)
        gain = metered_gain(radiance) * float(rng.uniform(0.75, 1.35))
        yield exposed(radiance, gain, camera, SensorSettings(), rng), scene.truth(camera, T_world_cam).class_id


def render_pairs(
    world: World, count: int, size: str, rng: np.random.Generator, vehicle: VehicleSettings = EVERYDAY
) -> Iterator[StereoView]:
    """`count` stereo pairs of a world built for that size, from places as in `render_views`, as the vehicle's cameras see them."""
    cameras, given = true_cameras(vehicle, size), given_rig(vehicle, size).camera
    for _ in range(count):
        scene, T_world_left = _random_scene(world, size, rng)
        rendered = [scene.image(c.rendered, T_world_left @ c.T_left_cam) for c in cameras]
        gain = metered_gain(rendered[0])
        left, right = (
            developed(through_lens(radiance, camera, sensor.blur_px), gain, given, sensor, rng)
            for radiance, camera, sensor in zip(rendered, cameras, (vehicle.left, vehicle.right), strict=True)
        )
        yield StereoView(left, right, truth_of(scene, cameras[0], T_world_left))


def _random_scene(world: World, size: str, rng: np.random.Generator) -> tuple[Scene, NDArray[np.float64]]:
    """The scene around a vehicle in a random lane at a random moment, and T_world_cam (4, 4) of its left camera."""
    x, y, yaw = _random_place(world, rng)
    t_s = float(rng.uniform(0, 600))
    T_world_cam = camera_on_ground(x, y, yaw, float(rng.uniform(0, 100)))
    hidden = world.traffic.meeting(np.array([x]), np.array([y]), np.array([t_s]), 3.0)
    return world.scene(sized_rig(size).camera, T_world_cam, t_s, hidden), T_world_cam


def _random_place(world: World, rng: np.random.Generator) -> tuple[float, float, float]:
    """x, y m and yaw rad of a vehicle in a random lane, or, one time in eight, turning at a crossing."""
    graph = world.city.graph
    streets = graph.inner_streets()
    street = streets[rng.integers(len(streets))]
    a, b = (street.a, street.b) if rng.random() < 0.5 else (street.b, street.a)
    d = graph.nodes[b] - graph.nodes[a]
    length = float(np.hypot(*d))
    d /= length
    right = np.array([d[1], -d[0]])
    lane = AVENUE_LANE_M if street.is_avenue else LANE_M
    turning = rng.random() < 0.125
    along = rng.uniform(-6, 6) if turning else rng.uniform(6, length - 10)
    x, y = graph.nodes[a] + d * along + right * (lane + rng.uniform(-0.6, 0.5))
    yaw = float(np.arctan2(d[1], d[0])) + (rng.uniform(-0.8, 0.8) if turning else rng.normal(0, 0.04))
    return float(x), float(y), yaw
