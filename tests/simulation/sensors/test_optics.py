"""True cameras: where their pixels look, what they see, and what lens and shutter do to an image."""

import numpy as np
import pytest

from simulation.naive import ray_hits
from wayloom.errors import ConfigError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.lens import RightLens
from wayloom.geometry.rectification import DistortedCamera, rectifying_maps
from wayloom.simulation.kernels import optics as kernels
from wayloom.simulation.kernels.arrays import View
from wayloom.simulation.rendering.renderer import Truth, World
from wayloom.simulation.sensors.optics import TrueCamera, culling_camera, through_lens, true_cameras, truth_of
from wayloom.simulation.textures.materials import CUTOUTS
from wayloom.simulation.vehicle.rig_faults import FAULTS, LENS
from wayloom.simulation.vehicle.rigs import given_rig
from wayloom.simulation.vehicle.vehicle_settings import RightLensSettings, VehicleSettings

STRONG = RightLensSettings(
    pitch_rad=0.004, yaw_rad=-0.006, roll_rad=0.005, ty=0.02, tz=-0.03, focal_ratio=1.01, cx_shift_px=6.0, k1=0.02, p1=0.003,
    p2=-0.004,
)  # fmt: skip


def pixels(camera: TrueCamera) -> np.ndarray:
    """(h w, 2) places in the drawn image."""
    if camera.lens_uv is not None:
        return camera.lens_uv.reshape(-1, 2).astype(float)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    return np.column_stack([u.ravel(), v.ravel()]).astype(float)


def test_the_filter_neither_moves_nor_blurs_by_where_it_falls() -> None:
    for b in (0.0, 0.65, 1.0):
        for phase in np.linspace(0, 0.999, 7):
            x = np.arange(-1, 3) - phase
            w = np.array([kernels.filter_weight(np.float32(abs(d)), np.float32(b)) for d in x])
            assert w.sum() == pytest.approx(1, abs=1e-5)
            assert w @ x == pytest.approx(0, abs=1e-5)
            assert w @ x**2 == pytest.approx(b / 3, abs=1e-5)


@pytest.mark.parametrize("lens", [FAULTS["lens"], STRONG])
def test_pixels_of_the_right_camera_look_where_the_lens_model_says(lens: RightLensSettings) -> None:
    vehicle = VehicleSettings(right_lens=lens)
    rig, (_, right) = given_rig(vehicle, "half"), true_cameras(vehicle, "half")
    depth = np.random.default_rng(0).uniform(3, 80, right.width * right.height)
    p_right = right.rendered.rays(pixels(right)) * depth[:, None]
    p_ideal = se3.transform(right.T_left_cam, p_right) + np.array(rig.t_right_left)
    found = lens.lens(0.5).real_pixels(rig.camera, rig.baseline_m, rig.camera.project(p_ideal), 1 / p_ideal[:, 2])
    v, u = np.mgrid[0 : right.height, 0 : right.width]
    np.testing.assert_allclose(found, np.column_stack([u.ravel(), v.ravel()]), atol=2e-4)


def test_a_perfect_rig_is_drawn_as_it_is_given() -> None:
    left, right = true_cameras(VehicleSettings(rig="kitti"), "full")
    assert left.rendered == right.rendered == given_rig(VehicleSettings(rig="kitti"), "full").camera
    assert left.lens_uv is None
    np.testing.assert_allclose(right.T_left_cam[:3, 3], (0.537, 0, 0))


def test_raw_images_are_what_a_reader_rectifies() -> None:
    distortion = (-0.3, 0.1, 0.001, -0.0005, 0.0)
    left, _ = true_cameras(VehicleSettings(distortion=distortion), "quarter")
    given = given_rig(VehicleSettings(), "quarter").camera
    u, v = rectifying_maps(DistortedCamera(given, distortion), np.eye(3), given)
    assert left.lens_uv is not None
    drawn_offset = np.array([left.rendered.cx - given.cx, left.rendered.cy - given.cy])
    for y, x in ((20, 40), (47, 176), (80, 300)):
        x0, y0 = int(u[y, x]), int(v[y, x])
        fx, fy = u[y, x] - x0, v[y, x] - y0
        near = left.lens_uv[y0 : y0 + 2, x0 : x0 + 2] - drawn_offset
        place = (near[0, 0] * (1 - fx) + near[0, 1] * fx) * (1 - fy) + (near[1, 0] * (1 - fx) + near[1, 1] * fx) * fy
        np.testing.assert_allclose(place, (x, y), atol=0.01)


def test_a_lens_that_folds_within_the_image_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"pixels see nothing through the lens.*weaken it"):
        true_cameras(VehicleSettings(distortion=(-0.6, 0.0, 0.0, 0.0, 0.0)), "quarter")


def test_the_size_of_each_fault_is_as_documented() -> None:
    camera, size = given_rig(VehicleSettings(), "full").camera, {}
    v, u = np.mgrid[0:376:25, 0:1408:67].astype(float)
    uv = np.column_stack([u.ravel(), v.ravel()])
    for name, fault in FAULTS.items():
        size[name] = np.abs(fault.lens().real_pixels(camera, 0.594, uv) - uv).max(axis=0)
    assert size["perfect"].max() < 1e-9
    assert size["rows"][1] == pytest.approx(1.0, abs=0.1)
    assert size["offset"] == pytest.approx((1.0, 0.0))
    assert size["lens"].max() == pytest.approx(1.9, abs=0.1)
    assert size["worn"] == pytest.approx((2.0, 1.9), abs=0.1)


@pytest.mark.parametrize("lens", [LENS, STRONG])
def test_the_true_right_images_truth_lands_on_the_left_within_a_tenth_of_a_pixel(
    lens: RightLensSettings, world: World, poses: list[np.ndarray]
) -> None:
    cameras = true_cameras(VehicleSettings(right_lens=lens), "quarter")
    left, right = cameras
    bf, off = given_rig(VehicleSettings(), "quarter").bf, []
    for T in poses:
        scene = world.scene(culling_camera(cameras), T, 2.0)
        seen_left, seen = (truth_of(scene, camera, T @ camera.T_left_cam) for camera in cameras)
        p_left = se3.transform(right.T_left_cam, right.rendered.rays(pixels(right)) * seen.depth.astype(float).reshape(-1, 1))
        uv = left.rendered.project(p_left)
        chosen = plane(seen).ravel() & left.rendered.contains(uv, 2.0)
        x, y = np.floor(uv[chosen]).astype(int).T
        chosen[chosen] = plane(seen_left)[y, x] & plane(seen_left)[y + 1, x + 1]
        x, y = np.floor(uv[chosen]).astype(int).T
        same = seen_left.instance[y, x] == seen.instance.ravel()[chosen]
        inverse, (fx, fy) = 1 / seen_left.depth.astype(float)[y[same], x[same]], (uv[chosen] - np.column_stack([x, y])).T
        right_of, below = (1 / seen_left.depth.astype(float)[y[same] + j, x[same] + i] for i, j in ((1, 0), (0, 1)))
        inverse = inverse + fx[same] * (right_of - inverse) + fy[same] * (below - inverse)
        off.append(bf * (inverse - 1 / p_left[chosen][same, 2]))
    error = np.concatenate(off)
    hidden = error > 0.1  # something nearer stands before it in the left image
    assert len(error) > 15_000
    assert hidden.mean() < 0.02
    assert np.abs(error[~hidden]).max() < 0.1


def plane(truth: Truth) -> np.ndarray:
    """(h, w) whether a pixel and its neighbours see one plane of one thing: inverse depth is affine in the pixel there."""
    out = np.zeros(truth.depth.shape, bool)
    inverse = 1 / np.where(truth.depth > 0, truth.depth, np.nan).astype(float)
    bend = np.abs(inverse[2:, 1:-1] - 2 * inverse[1:-1, 1:-1] + inverse[:-2, 1:-1])
    bend = np.maximum(bend, np.abs(inverse[1:-1, 2:] - 2 * inverse[1:-1, 1:-1] + inverse[1:-1, :-2]))
    bend = np.maximum(bend, np.abs(inverse[2:, 2:] - inverse[2:, :-2] - inverse[:-2, 2:] + inverse[:-2, :-2]))
    out[1:-1, 1:-1] = bend < 2e-5
    around = np.stack([truth.instance[1 + j : -1 + j or None, 1 + i : -1 + i or None] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    out[1:-1, 1:-1] &= np.all(around == around[0], axis=0)
    return out


def test_depth_through_a_lens_is_where_the_ray_meets_the_triangles(world: World, poses: list[np.ndarray]) -> None:
    camera, T_left = true_cameras(VehicleSettings(right_lens=STRONG), "quarter")[1], poses[0]
    scene = world.scene(culling_camera((camera,)), T_left, 2.0)
    T = T_left @ camera.T_left_cam
    truth, corners = truth_of(scene, camera, T), scene.mesh.corners.astype(float)
    rays = camera.rendered.rays(pixels(camera)).reshape(camera.height, camera.width, 3)
    smooth, rng, tested = np.argwhere(plane(truth)), np.random.default_rng(3), 0
    for v, u in smooth[rng.choice(len(smooth), 60, replace=False)]:
        depths = ray_hits(T[:3, 3], T[:3, :3] @ rays[v, u], corners)
        nearest = int(np.argmin(depths))
        if scene.mesh.material[nearest] not in CUTOUTS:
            assert truth.depth[v, u] == pytest.approx(depths[nearest], rel=2e-4)
            assert truth.class_id[v, u] == scene.mesh.class_id[nearest]
            tested += 1
    assert tested > 40


def ramp(width: int, height: int) -> np.ndarray:
    """(height, width, 3) an image that a camera can resolve."""
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    wave = 0.5 + 0.2 * np.sin(0.35 * u + 0.1 * v) + 0.1 * np.cos(0.5 * v)
    return np.stack([wave, 0.5 * wave, 1 - wave], axis=-1).astype(np.float32)


def test_a_lens_shows_the_drawn_image_where_it_says() -> None:
    width, height = 60, 40
    uv = np.random.default_rng(0).uniform(3, 36, (height, width, 2)).astype(np.float32)
    camera = TrueCamera(width, height, PinholeCamera(50, 50, 30, 20, width, height), np.eye(4), uv)
    found = through_lens(ramp(width, height), camera, 0.0)
    u, v = uv[..., 0], uv[..., 1]
    np.testing.assert_allclose(found[..., 0], 0.5 + 0.2 * np.sin(0.35 * u + 0.1 * v) + 0.1 * np.cos(0.5 * v), atol=0.004)


def test_with_no_lens_and_no_motion_the_kernel_is_the_plain_filter() -> None:
    image, camera = ramp(50, 30), PinholeCamera(40, 40, 25, 15, 50, 30)
    plain = through_lens(image, TrueCamera(50, 30, camera, np.eye(4)), 0.464)
    v, u = np.mgrid[0:30, 0:50]
    own_places = np.stack([u, v], axis=-1).astype(np.float32)
    np.testing.assert_allclose(through_lens(image, TrueCamera(50, 30, camera, np.eye(4), own_places), 0.464), plain, atol=1e-5)


def test_an_open_shutter_is_the_mean_of_the_images_of_its_moments() -> None:
    """Before a wall, the moving camera's images are known for every moment: the wall's pattern, shifted and scaled."""
    width, height, z, f = 80, 50, 5.0, 60.0
    camera = PinholeCamera(f, f, 40.0, 25.0, width, height)
    way = np.array([0.35, -0.1, 0.2, 0.01, -0.02, 0.015])
    v, u = np.mgrid[0:height, 0:width].astype(float)
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))

    def seen(s: float) -> np.ndarray:
        T_mid_then = se3.exp(s * way)
        d, o = rays @ T_mid_then[:3, :3].T, T_mid_then[:3, 3]
        hit = o + d * ((z - o[2]) / d[:, 2])[:, None]
        return (0.5 + 0.2 * np.sin(9.0 * hit[:, 0] + 3.0 * hit[:, 1]) + 0.1 * np.cos(10.0 * hit[:, 1])).reshape(height, width)

    expected = np.mean([seen(s) for s in (np.arange(64) + 0.5) / 64 - 0.5], axis=0)
    rendered = np.repeat(seen(0.0)[..., None], 3, axis=2).astype(np.float32)
    depth = np.full((height, width), z, np.float32)
    found = through_lens(rendered, TrueCamera(width, height, camera, np.eye(4)), 0.0, depth, way)[..., 0]
    inner = np.s_[8:-8, 8:-8]
    assert np.abs(expected - rendered[..., 0])[inner].max() > 0.05
    assert np.abs(found - expected)[inner].max() < 0.006


def test_what_is_infinitely_far_is_smeared_by_turning_alone() -> None:
    camera = PinholeCamera(60.0, 60.0, 40.0, 25.0, 80, 50)
    opening, closing = se3.exp(np.array([0.5, 0.2, 0.9, 0, 0.02, 0]))[:3], se3.exp(np.array([-0.5, -0.2, -0.9, 0, -0.02, 0]))[:3]
    view = View(camera.fx, camera.fy, camera.cx, camera.cy, np.eye(4))
    u0, v0 = kernels.moved_pixel(view, 0.0, 0.0, 0.0, opening)
    u1, _ = kernels.moved_pixel(view, 0.0, 0.0, 0.0, closing)
    assert (u0 - u1, v0) == pytest.approx((2 * 60 * np.tan(0.02), 25.0), abs=1e-9)


def test_a_camera_that_culls_holds_the_views_of_both(world: World, poses: list[np.ndarray]) -> None:
    cameras = true_cameras(VehicleSettings(right_lens=STRONG), "quarter")
    wide = culling_camera(cameras)
    for camera in cameras:
        rays = camera.rendered.rays(pixels(camera)) @ camera.T_left_cam[:3, :3].T
        assert np.all(wide.contains(wide.project(rays)))
    assert RightLens() == RightLensSettings().lens()
