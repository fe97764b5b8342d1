"""Whole captures: what a vehicle's cameras record on their way, and how its settings show in the images."""

import cv2
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.geometry.lens import RightLens
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.camera import developed
from wayloom.simulation.sensors.capture import Captured, CaptureSettings, ResumePoint, StereoCamera, capture
from wayloom.simulation.sensors.glare import open_sky_at_sun, with_glare
from wayloom.simulation.sensors.optics import TrueCamera, true_cameras
from wayloom.simulation.traffic.drives import RoutePlan, plan_drives
from wayloom.simulation.traffic.routes import Route
from wayloom.simulation.vehicle.rig_faults import WORN
from wayloom.simulation.vehicle.rigs import given_rig
from wayloom.simulation.vehicle.vehicle_settings import (
    ExposureSettings,
    GlareSettings,
    LightChange,
    RightLensSettings,
    SensorSettings,
    VehicleSettings,
)

EVERYTHING = VehicleSettings(
    right_lens=WORN,
    motion_blur=True,
    glare=GlareSettings(veil=0.03, sun=0.5),
    right=SensorSettings(gain=1.1, offset=3.0, vignette=1.5, gamma_ratio=1.05),
    exposure=ExposureSettings(each_for_itself=True, time_constant_s=0.2),
)


@pytest.fixture(scope="module")
def route(world: World) -> Route:
    way = RoutePlan(nodes=(4, 5, 6, 10), reference=2, before_m=25.0, start_s=7.0, duration_s=2.0)
    return plan_drives(world.city, [way])[0].route


def pairs(
    world: World, route: Route, vehicle: VehicleSettings, count: int = 3, threads: int = 1, after_s: float = 0.0
) -> list[Captured]:
    t_s = route.start_s + after_s + 0.1 * np.arange(count)
    return list(capture(StereoCamera(vehicle, "quarter", route), world, t_s, CaptureSettings(frozenset(), True, (1, 2)), threads))


def test_captures_do_not_depend_on_the_number_of_threads(world: World, route: Route) -> None:
    one, three = (pairs(world, route, EVERYTHING, 4, threads) for threads in (1, 3))
    assert len(one) == len(three) == 4
    for a, b in zip(one, three, strict=True):
        np.testing.assert_array_equal(a.left, b.left)
        np.testing.assert_array_equal(a.right, b.right)
        assert a.exposures == b.exposures
        assert a.truth is not None
        assert b.truth is not None
        np.testing.assert_array_equal(a.truth[1].depth, b.truth[1].depth)


def test_a_capture_that_begins_later_is_the_rest_of_the_whole(world: World, route: Route) -> None:
    whole = pairs(world, route, EVERYTHING, 4)
    t_s = route.start_s + 0.1 * np.arange(4)
    camera = StereoCamera(EVERYTHING, "quarter", route)
    rest = list(
        capture(camera, world, t_s, CaptureSettings(frozenset(), False, (1, 2)), 2, ResumePoint(first=2, factors=whole[1].factors))
    )
    assert len(rest) == 2
    for a, b in zip(whole[2:], rest, strict=True):
        np.testing.assert_array_equal(a.left, b.left)
        np.testing.assert_array_equal(a.right, b.right)


def test_cameras_of_one_pair_stand_a_baseline_apart(world: World, route: Route) -> None:
    left, right = StereoCamera(VehicleSettings(rig="kitti"), "quarter", route).poses(route.start_s)
    np.testing.assert_allclose((se3.inverse(left) @ right)[:3, 3], (0.537, 0, 0), atol=1e-9)


def test_gain_of_the_right_camera_shows_and_is_the_same_in_all_frames(world: World, route: Route) -> None:
    quiet = SensorSettings(noise=0.0)
    plain = pairs(world, route, VehicleSettings(left=quiet, right=quiet), 2)
    louder = pairs(world, route, VehicleSettings(left=quiet, right=SensorSettings(noise=0.0, gain=1.2)), 2)
    for a, b in zip(plain, louder, strict=True):
        np.testing.assert_array_equal(a.left, b.left)
        middle = (a.right > 20) & (a.right < 150)
        ratio = b.right[middle].astype(float) / a.right[middle]
        assert np.median(ratio) == pytest.approx(1.2 ** (1 / 1.2), rel=0.02)


def test_dimmed_light_darkens_the_image_until_exposure_follows(world: World, route: Route) -> None:
    settings = ExposureSettings(time_constant_s=0.15, compensation=1.0)
    fall = (LightChange(from_s=0.05, to_s=9.0, factor=0.25, ramp_s=0.0),)
    plain = pairs(world, route, VehicleSettings(exposure=settings), 8)
    dimmed = pairs(world, route, VehicleSettings(exposure=settings.model_copy(update={"light_changes": fall})), 8)
    means = np.array([[c.left.mean() for c in drive] for drive in (plain, dimmed)])
    assert means[1, 0] == means[0, 0]
    assert means[1, 1] < 0.7 * means[0, 1]
    assert means[1, 7] > 0.95 * means[0, 7]
    assert dimmed[7].exposures[0].factor == pytest.approx(4 * plain[7].exposures[0].factor, rel=0.05)
    assert dimmed[7].exposure_s[0] == pytest.approx(dimmed[7].exposures[0].factor * settings.unit_s)


def test_motion_blur_takes_fine_detail_along_and_leaves_the_far_alone(world: World, route: Route) -> None:
    slow = ExposureSettings(unit_s=0.03, longest_s=0.05, shortest_s=0.03)
    quiet = SensorSettings(noise=0.0)
    settings = {"exposure": slow, "left": quiet, "right": quiet}
    after_s = np.arange(0.0, 24.0, 0.5)
    fastest_s = float(after_s[np.argmax(route.travelled(route.start_s + after_s, 1))])
    sharp = pairs(world, route, VehicleSettings(**settings), 1, after_s=fastest_s)[0]
    smeared = pairs(world, route, VehicleSettings(**settings, motion_blur=True), 1, after_s=fastest_s)[0]
    assert sharp.truth is not None
    depth = sharp.truth[0].depth
    change = np.abs(sharp.left.astype(float) - smeared.left).mean(axis=2)
    near, far = (depth > 0) & (depth < 8), depth > 60
    assert change[near].mean() > 4 * change[far].mean()


def test_a_developed_image_has_vignette_offset_and_noise_as_specified() -> None:
    camera = given_rig(VehicleSettings(), "quarter").camera
    grey = np.full((camera.height, camera.width, 3), 0.2, np.float32)
    rng = np.random.default_rng(0)
    plain = developed(grey, 1.0, camera, SensorSettings(noise=0.0, vignette=0.0), rng)
    assert np.ptp(plain) == 0
    offset = developed(grey, 1.0, camera, SensorSettings(noise=0.0, vignette=0.0, offset=7.0), rng)
    assert np.all(offset.astype(int) - plain == 7)
    dark = developed(grey, 1.0, camera, SensorSettings(noise=0.0, vignette=2.0), rng)
    corner = 1 + ((0 - camera.cx) / camera.fx) ** 2 + ((0 - camera.cy) / camera.fy) ** 2
    assert dark[0, 0, 0] / plain[0, 0, 0] == pytest.approx(corner ** (-2 / 1.2), rel=0.02)
    once, amplified = (developed(grey, 1.0, camera, SensorSettings(vignette=0.0), rng, a).std() for a in (1.0, 4.0))
    assert amplified > 1.8 * once  # shot noise grows with the root of the gain, the amplifier's own with the gain


def test_a_veil_lifts_shadows_and_the_sun_blinds_where_it_stands() -> None:
    camera = true_cameras(VehicleSettings(), "quarter")[0]
    light = np.full((camera.height, camera.width, 3), 0.02, np.float32)
    light[:30] = 2.0
    sun = np.array([0.1, -0.15, 1.0]) / np.linalg.norm([0.1, -0.15, 1.0])
    rgb = np.array([2.6, 2.4, 2.1], np.float32)
    veiled = with_glare(light, camera, GlareSettings(veil=0.1), sun, rgb, 1.0)
    assert veiled[-1].mean() > 1.8 * 0.02
    assert veiled.mean() == pytest.approx(light.mean(), rel=0.15)
    blinded = with_glare(light, camera, GlareSettings(sun=1.0), sun, rgb, 1.0)
    u, v = np.rint(camera.rendered.project(sun[None])[0]).astype(int)
    assert blinded[v, u].min() > 20
    assert np.argmax((blinded - light)[..., 0]) == v * camera.width + u
    np.testing.assert_array_equal(with_glare(light, camera, GlareSettings(sun=1.0), sun, rgb, 0.0), light)
    np.testing.assert_array_equal(with_glare(light, camera, GlareSettings(sun=1.0), -sun, rgb, 1.0), light)


def test_the_sun_is_hidden_by_what_stands_before_it() -> None:
    camera: TrueCamera = true_cameras(VehicleSettings(), "quarter")[0]
    sun = np.array([0.1, -0.15, 1.0])
    u, v = np.rint(camera.rendered.project(sun[None])[0]).astype(int)
    depth = np.zeros((camera.height, camera.width), np.float32)
    assert open_sky_at_sun(depth, camera, sun) == 1.0
    depth[:, u:] = 10.0
    assert 0.3 < open_sky_at_sun(depth, camera, sun) < 0.6
    depth[:] = 10.0
    assert open_sky_at_sun(depth, camera, sun) == 0.0
    assert open_sky_at_sun(np.zeros_like(depth), camera, -sun) == 0.0
    assert open_sky_at_sun(np.zeros_like(depth), camera, np.array([0.0, -0.9, 1.0])) == 0.0
    assert v < camera.height


def shift_between(world: World, route: Route, vehicle: VehicleSettings, lens: RightLens) -> np.ndarray:
    """(4, 2) px: how far the right image lies from where `lens` sends the left image's points, in each quarter of the view."""
    pair, rig = pairs(world, route, vehicle, 1)[0], given_rig(vehicle, "quarter")
    assert pair.truth is not None
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (pair.left, pair.right)]
    gradient = [cv2.Sobel(grey[1], cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1))]
    depth = pair.truth[0].depth.astype(float)
    v, u = np.argwhere((depth > 0) & (depth < 40)).T
    p_ideal = rig.camera.rays(np.column_stack([u, v]).astype(float)) * depth[v, u, None] + np.array(rig.t_right_left)
    place = lens.real_pixels(rig.camera, rig.baseline_m, rig.camera.project(p_ideal), 1 / p_ideal[:, 2])
    inside, out = rig.camera.contains(place, 5.0), []
    for left in (True, False):
        for top in (True, False):
            mine = inside & ((u < rig.camera.cx) == left) & ((v < rig.camera.cy) == top)
            shift = np.zeros(2)
            for _ in range(12):  # Gauss and Newton, without what is hidden in one of the images, or mirrors
                x, y = (place[mine] + shift).astype(np.float32).T[..., None]
                gx, gy, seen = (cv2.remap(image, x, y, cv2.INTER_CUBIC)[:, 0] for image in (*gradient, grey[1]))
                residual = grey[0][v[mine], u[mine]] - seen
                kept = np.abs(residual) < 15
                J = np.column_stack([gx, gy])[kept].astype(float)
                shift += np.clip(np.linalg.solve(J.T @ J, J.T @ residual[kept]), -0.5, 0.5)
            out.append(shift)
    return np.array(out)


def test_the_right_image_lies_where_the_true_lens_sends_the_left_images_points(world: World, route: Route) -> None:
    strong = RightLensSettings(
        pitch_rad=0.002, roll_rad=0.004, focal_ratio=1.005, cx_shift_px=-2.0, k1=0.015, p1=0.002, p2=-0.003, ty=0.02
    )
    quiet = SensorSettings(noise=0.0)
    for settings in (RightLensSettings(), strong):
        vehicle = VehicleSettings(right_lens=settings, left=quiet, right=quiet)
        assert np.abs(shift_between(world, route, vehicle, settings.lens(0.25))).max() < 0.15  # reflections differ between sides
    assert np.abs(shift_between(world, route, vehicle, RightLens())).max() > 0.5
