"""Weather, sun and what surfaces do with light."""

from dataclasses import replace

import numpy as np
import pytest

from wayloom.config.classes import SKY
from wayloom.simulation.kernels import shade
from wayloom.simulation.models import two_wheelers, vehicles
from wayloom.simulation.models.cars import BRAKE_LAMP, TAIL_LAMP
from wayloom.simulation.models.mesh import empty
from wayloom.simulation.rendering.light import WEATHERS, CityLight, LightSettings
from wayloom.simulation.rendering.rain import with_rain
from wayloom.simulation.rendering.renderer import Scene, World
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.vehicle.rigs import sized_rig

CAMERA = sized_rig("quarter").camera
DRY = LightSettings(cloud_cover=0.4)


def lit(world: World, settings: LightSettings, T: np.ndarray) -> Scene:
    """The scene before a camera in that light."""
    return replace(world, light=CityLight(world.city, world.textures, settings)).scene(CAMERA, T, 2.0)


@pytest.mark.parametrize("weather", WEATHERS)
def test_every_weather_gives_finite_light_and_the_same_twice(world: World, poses: list[np.ndarray], weather: str) -> None:
    first, second = (lit(world, WEATHERS[weather], poses[0]).image(CAMERA, poses[0]) for _ in range(2))
    assert np.all(np.isfinite(first))
    assert float(first.min()) >= 0
    assert float(first.max()) > 0.1
    np.testing.assert_array_equal(first, second)


def test_fog_takes_what_is_far_towards_the_horizons_colour_and_hides_the_sky(world: World, poses: list[np.ndarray]) -> None:
    clear, foggy = (lit(world, DRY.model_copy(update={"haze_per_m": haze}), poses[0]) for haze in (0.0, 0.03))
    truth = clear.truth(CAMERA, poses[0])
    images = clear.image(CAMERA, poses[0]), foggy.image(CAMERA, poses[0])
    off = [np.abs(image - foggy.light.horizon_rgb).mean(axis=2) for image in images]
    far, near = truth.depth > 60, (truth.depth > 0) & (truth.depth < 8)
    assert np.median(off[1][far]) < 0.3 * np.median(off[0][far])
    assert np.median(off[1][near]) > 0.7 * np.median(off[0][near])
    sky = truth.class_id == SKY
    assert off[1][sky].mean() < 0.3 * off[0][sky].mean()


def test_a_closed_cover_of_clouds_shows_no_blue(world: World, poses: list[np.ndarray]) -> None:
    settings = LightSettings(cloud_cover=1.0, sun_strength=0.2)
    scene = lit(world, settings, poses[0])
    sky = scene.image(CAMERA, poses[0])[scene.truth(CAMERA, poses[0]).class_id == SKY]
    assert np.median(sky[:, 2] / sky[:, 0]) < 1.2
    low, middle, high = np.percentile(sky.mean(axis=1), (10, 50, 90))
    assert high - low < 0.25 * middle


def test_a_wet_street_is_darker_than_a_dry_one_and_leaves_are_as_before(world: World, poses: list[np.ndarray]) -> None:
    images, truth = [], None
    for wetness in (0.0, 0.7):
        scene = lit(world, DRY.model_copy(update={"wetness": wetness}), poses[0])
        truth = scene.truth(CAMERA, poses[0])
        images.append(scene.image(CAMERA, poses[0]).mean(axis=2))
    assert truth is not None
    near_road, leaves = (truth.class_id == 0) & (truth.depth < 10), truth.class_id == 8
    assert np.median(images[1][near_road]) < 0.85 * np.median(images[0][near_road])
    np.testing.assert_allclose(np.median(images[1][leaves]), np.median(images[0][leaves]), rtol=0.01)


def test_a_low_sun_throws_longer_shadows(world: World, poses: list[np.ndarray]) -> None:
    shares = []
    for elevation in (60.0, 8.0):
        light = lit(world, DRY.model_copy(update={"sun_elevation_deg": elevation}), poses[0]).light
        x, y, z = poses[0][:3, 3]
        steps = np.arange(-20, 20, 1.7)
        shares.append(np.mean([shade.sunlit(light, x + a, y + b, z - 1.5) for a in steps for b in steps]))
    assert shares[1] < 0.7 * shares[0]


def test_the_way_to_the_sky_is_free_upwards_and_blocked_by_a_house(world: World, poses: list[np.ndarray]) -> None:
    light = lit(world, DRY, poses[0]).light
    x, y, z = (float(v) for v in poses[0][:3, 3])
    assert shade.open_along(light, x, y, z, 0.0, 0.0, 1.0) == 1.0
    around = [shade.open_along(light, x, y, z, np.cos(a), np.sin(a), 0.02) for a in np.linspace(0, 2 * np.pi, 32)]
    assert min(around) == 0.0


def test_facets_have_no_mean_and_differ_between_left_and_right(world: World, poses: list[np.ndarray]) -> None:
    light = lit(world, DRY, poses[0]).light
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0, 300, (2, 4000))
    left = np.array([shade.facets(light, a, b, 0.1, 0.05, 0.02) for a, b in zip(u, v, strict=True)])
    assert abs(left.mean()) < 0.08
    assert 0.7 < left.std() < 1.1
    right = np.array([shade.facets(light, a, b, 0.1 + 0.594 / 15, 0.05, 0.02) for a, b in zip(u, v, strict=True)])
    hardly = np.array([shade.facets(light, a, b, 0.1 + 0.594 / 300, 0.05, 0.02) for a, b in zip(u, v, strict=True)])
    assert 0.2 < np.corrcoef(left, right)[0, 1] < 0.95
    assert np.corrcoef(left, hardly)[0, 1] > 0.97


def test_rain_is_the_same_twice_other_for_each_camera_and_denser_when_it_pours(poses: list[np.ndarray]) -> None:
    grey, sky = np.full((CAMERA.height, CAMERA.width, 3), 0.1, np.float32), np.float32([0.7, 0.7, 0.7])
    T_right = poses[0].copy()
    T_right[:3, 3] += 0.6 * poses[0][:3, 0]
    drizzle, again = (with_rain(grey, CAMERA, poses[0], 1.0, 3.0, sky) for _ in range(2))
    np.testing.assert_array_equal(drizzle, again)
    later, right, pours = (
        with_rain(grey, CAMERA, T, rate, t, sky)
        for T, rate, t in ((poses[0], 1.0, 3.1), (T_right, 1.0, 3.0), (poses[0], 20.0, 3.0))
    )
    assert np.any(later != drizzle)
    assert np.any(right != drizzle)
    assert (pours - grey).mean() > 2.5 * (drizzle - grey).mean() > 0
    assert drizzle.max() <= 0.7


def test_rear_lamps_light_up_when_a_vehicle_brakes(world: World) -> None:
    for build in (vehicles.lorry, vehicles.bus, two_wheelers.motorcycle, lambda: vehicles.car(vehicles.CAR_PROFILES[0])):
        mesh = build()
        lamps = np.all(mesh.tint == np.float32(TAIL_LAMP), axis=1)
        assert lamps.any()
        assert np.all(mesh.material[lamps] == Material.LIT)
        assert np.all(vehicles.braking(mesh).tint[lamps] == np.float32(BRAKE_LAMP))
    assert world.textures.glow[Material.LIT] > 0


def test_the_light_around_a_place_does_not_depend_on_what_was_asked_before(world: World, poses: list[np.ndarray]) -> None:
    x, y = poses[0][:2, 3]
    light = CityLight(world.city, world.textures, DRY)
    for step in range(15):
        light.at(x + 60.0 * step, y, empty())
    for one, other in zip(light.at(x, y, empty()), CityLight(world.city, world.textures, DRY).at(x, y, empty()), strict=True):
        for a, b in zip(one, other, strict=True) if isinstance(one, tuple) else [(one, other)]:
            np.testing.assert_array_equal(a, b)
