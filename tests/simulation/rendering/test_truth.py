"""The truth about what a camera in the city sees."""

import numpy as np
import pytest

from simulation.naive import pixel_ray, ray_hits
from wayloom.config.classes import CLASS_ID, SKY
from wayloom.geometry.lens import RightLens
from wayloom.simulation.models.mesh import join
from wayloom.simulation.rendering.renderer import Scene, World
from wayloom.simulation.sensors.optics import T_left_right
from wayloom.simulation.textures.materials import CUTOUTS
from wayloom.simulation.traffic.traffic import FIRST_MOVER
from wayloom.simulation.vehicle.rigs import sized_rig

RIG = sized_rig("quarter")


def test_depth_and_class_agree_with_rays_cast_through_all_triangles(world: World, poses: list[np.ndarray]) -> None:
    camera, rng = RIG.camera, np.random.default_rng(1)
    tested = 0
    for T in poses:
        scene = world.scene(camera, T, 2.0)
        truth, mesh = scene.truth(camera, T), scene.mesh
        solid = ~np.isin(mesh.material, CUTOUTS)
        corners = mesh.corners.astype(float)
        for _ in range(25):
            u, v = int(rng.integers(camera.width)), int(rng.integers(camera.height))
            depths = ray_hits(T[:3, 3], pixel_ray(u, v, camera.fx, camera.fy, camera.cx, camera.cy, T), corners)
            nearest = int(np.argmin(depths))
            if np.isfinite(depths[nearest]) and solid[nearest]:
                assert truth.depth[v, u] == pytest.approx(depths[nearest], rel=1e-4)
                assert truth.class_id[v, u] == mesh.class_id[nearest]
                assert truth.instance[v, u] == mesh.instance[nearest]
                tested += 1
    assert tested > 25


def on_one_plane(depth: np.ndarray, instance: np.ndarray) -> bool:
    """Whether neighbouring pixels of a row see one plane: inverse depth is affine in the pixel there."""
    return bool(np.all(depth > 0) and np.all(instance == instance[0]) and np.ptp(np.diff(1 / depth)) < 1e-5)


def test_the_right_images_truth_lands_on_the_left_within_a_tenth_of_a_pixel(world: World, poses: list[np.ndarray]) -> None:
    camera, bf = RIG.camera, RIG.bf
    off: list[float] = []
    for T in poses:
        scene = world.scene(camera, T, 2.0)
        left, right = scene.truth(camera, T), scene.truth(camera, T @ T_left_right(RIG, RightLens()))
        for v in range(0, camera.height, 2):
            for u in range(2, camera.width - 2):
                if not on_one_plane(right.depth[v, u - 1 : u + 2], right.instance[v, u - 1 : u + 2]):
                    continue
                disparity = bf / right.depth[v, u]
                x = u + disparity
                x0 = int(np.floor(x))
                if x0 + 2 >= camera.width or not on_one_plane(left.depth[v, x0 - 1 : x0 + 3], left.instance[v, x0 - 1 : x0 + 3]):
                    continue
                if left.instance[v, x0] == right.instance[v, u]:
                    off.append(bf * ((1 - (x - x0)) / left.depth[v, x0] + (x - x0) / left.depth[v, x0 + 1]) - disparity)
    hidden = np.array(off) > 0.1  # something nearer stands before it in the left image
    assert len(off) > 4000
    assert hidden.mean() < 0.02
    assert np.abs(np.array(off)[~hidden]).max() < 0.1


def test_culling_leaves_the_picture_as_it_is(world: World, poses: list[np.ndarray]) -> None:
    camera, T = RIG.camera, poses[1]
    culled = world.scene(camera, T, 2.0)
    movers = [m.mesh for m in world.traffic.around(float(T[0, 3]), float(T[1, 3]), 2.0)]
    whole = Scene(join([*movers, world.city.whole()]), culled.light, world.textures)
    assert len(culled.mesh) < 0.6 * len(whole.mesh)
    np.testing.assert_array_equal(culled.truth(camera, T).depth, whole.truth(camera, T).depth)
    np.testing.assert_array_equal(culled.image(camera, T), whole.image(camera, T))


def test_sky_has_no_depth_and_no_instance(world: World, poses: list[np.ndarray]) -> None:
    truth = world.scene(RIG.camera, poses[0], 2.0).truth(RIG.camera, poses[0])
    sky = truth.class_id == SKY
    assert sky.any()
    assert np.all(truth.depth[sky] == 0)
    assert np.all(truth.instance[sky] == 0)
    assert np.all(truth.depth[~sky] > 0)


def test_the_same_place_is_drawn_alike_whatever_was_drawn_before(world: World, poses: list[np.ndarray]) -> None:
    first = world.scene(RIG.camera, poses[0], 2.0).image(RIG.camera, poses[0])
    for T in poses[1:]:
        world.scene(RIG.camera, T, 5.0).image(RIG.camera, T)
    np.testing.assert_array_equal(world.scene(RIG.camera, poses[0], 2.0).image(RIG.camera, poses[0]), first)


def test_all_nineteen_classes_are_in_the_city(world: World) -> None:
    standing = set(np.unique(world.city.whole().class_id).tolist())
    moving = {int(c) for t in (5.0, 60.0) for p in world.traffic.around(0.0, 0.0, t) for c in np.unique(p.mesh.class_id)}
    assert standing | moving | {SKY} == set(range(19))
    assert {CLASS_ID["train"], CLASS_ID["rider"], CLASS_ID["person"], CLASS_ID["bus"]} <= moving


def test_standing_and_moving_things_have_numbers_of_their_own(world: World) -> None:
    assert 0 < world.city.whole().instance.max() < FIRST_MOVER
    placed = [p for p in world.traffic.around(0.0, 0.0, 3.0) if int(p.mesh.class_id[0]) != CLASS_ID["traffic light"]]
    numbers = [int(p.mesh.instance[0]) for p in placed]
    assert len(set(numbers)) == len(numbers)
    assert min(numbers) >= FIRST_MOVER
