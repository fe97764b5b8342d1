"""LiDAR: points on what stands there, with its class and number, as noisy and as lossy as specified."""

import numpy as np
import pytest

from simulation.naive import ray_hits
from wayloom.config.classes import CLASS_ID, SKY
from wayloom.simulation.models.mesh import join
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.lidar import LidarScan, directions, scan
from wayloom.simulation.textures.materials import CUTOUTS
from wayloom.simulation.vehicle.rigs import sized_rig
from wayloom.simulation.vehicle.vehicle_settings import LidarSettings, VehicleSettings

EXACT = LidarSettings(rings=32, columns=512, range_noise_m=0.0, dropout=0.0)
T_CAM_LIDAR = VehicleSettings(lidar=EXACT).T_cam_lidar


@pytest.fixture(scope="module")
def turn(world: World, poses: list[np.ndarray]) -> LidarScan:
    return scan(world, poses[0] @ T_CAM_LIDAR, 2.0, EXACT, np.random.default_rng(0))


def test_shots_go_evenly_around_and_between_the_lowest_and_the_highest_ring() -> None:
    parts = [directions(EXACT, k) for k in range(4)]
    shots, ring = np.concatenate([d for d, _ in parts]), np.concatenate([r for _, r in parts])
    assert len(shots) == 32 * 512
    azimuth, elevation = np.arctan2(shots[:, 1], shots[:, 0]), np.degrees(np.arcsin(shots[:, 2]))
    for r in (0, 17, 31):
        np.testing.assert_allclose(np.diff(np.sort(azimuth[ring == r])), 2 * np.pi / 512, rtol=1e-9)
    assert elevation[ring == 0] == pytest.approx(2.0)
    assert elevation[ring == 31] == pytest.approx(-24.8)


def test_points_are_where_rays_meet_the_triangles_first(world: World, poses: list[np.ndarray], turn: LidarScan) -> None:
    T = poses[0] @ T_CAM_LIDAR
    movers = [m.mesh for m in world.traffic.around(float(T[0, 3]), float(T[1, 3]), 2.0)]
    mesh = join([*movers, world.city.chunks(world.city.around(float(T[0, 3]), float(T[1, 3]), 42.0))])
    corners, rng, off = mesh.corners.astype(float), np.random.default_rng(1), []
    reached = np.nonzero(np.linalg.norm(turn.points, axis=1) < 40.0)[0]
    for k in rng.choice(reached, 100, replace=False):
        point = turn.points[k].astype(float)
        far = np.linalg.norm(point)
        depths = ray_hits(T[:3, 3], T[:3, :3] @ point / far, corners)
        nearest = int(np.argmin(depths))
        if mesh.material[nearest] not in CUTOUTS:
            same = abs(depths[nearest] - far) < 0.01 and mesh.instance[nearest] == turn.instance[k]
            off.append(not same or mesh.class_id[nearest] != turn.class_id[k])
    assert len(off) > 70
    assert np.mean(off) < 0.06  # at borders a shot may meet the neighbour, less than a pixel of the drawn turn away


def test_scan_and_image_tell_the_same(world: World, poses: list[np.ndarray], turn: LidarScan) -> None:
    camera = sized_rig("half").camera
    truth = world.scene(camera, poses[0], 2.0).truth(camera, poses[0])
    p_cam = turn.points @ T_CAM_LIDAR[:3, :3].T + T_CAM_LIDAR[:3, 3]
    ahead = np.flatnonzero((p_cam[:, 2] > 1) & (p_cam[:, 2] < 40))
    uv = camera.project(p_cam[ahead])
    inside = camera.contains(uv)
    u, v = np.rint(uv[inside]).astype(int).T
    depth, k = truth.depth[v, u], ahead[inside]
    near = np.abs(depth - p_cam[k, 2]) < 0.02 * p_cam[k, 2]
    assert len(k) > 1000
    assert near.mean() > 0.75  # the scanner stands higher: it sees what the camera does not, and the other way
    assert np.mean(truth.class_id[v, u][near] == turn.class_id[k[near]]) > 0.97


def test_points_lie_on_all_sides_and_within_reach(turn: LidarScan) -> None:
    far = np.linalg.norm(turn.points, axis=1)
    assert far.min() >= EXACT.nearest_m - 1e-4
    assert far.max() <= EXACT.farthest_m + 1e-4
    azimuth = np.arctan2(turn.points[:, 1], turn.points[:, 0])
    assert np.all(np.histogram(azimuth, 16, (-np.pi, np.pi))[0] > 100)
    assert {CLASS_ID["road"], CLASS_ID["building"], CLASS_ID["sidewalk"]} <= set(np.unique(turn.class_id).tolist())
    assert SKY not in turn.class_id
    assert np.all(np.diff(turn.ring.astype(int)) >= 0)
    assert np.all((turn.reflectance >= 0) & (turn.reflectance <= 1))


def test_the_ground_is_seen_at_the_scanners_height_below(turn: LidarScan) -> None:
    near = (np.hypot(turn.points[:, 0], turn.points[:, 1]) < 8) & (turn.class_id == CLASS_ID["road"])
    assert np.median(turn.points[near, 2]) == pytest.approx(-(1.65 + 0.40), abs=0.15)


def test_ranges_and_losses_are_as_specified(world: World, poses: list[np.ndarray], turn: LidarScan) -> None:
    settings = EXACT.model_copy(update={"range_noise_m": 0.05, "dropout": 0.2})
    noisy = scan(world, poses[0] @ T_CAM_LIDAR, 2.0, settings, np.random.default_rng(0))
    assert len(noisy.points) / len(turn.points) == pytest.approx(0.8, abs=0.02)
    unit = [s.points / np.linalg.norm(s.points, axis=1, keepdims=True) for s in (turn, noisy)]
    place = {tuple(np.round(d * 5000).astype(int)): k for k, d in enumerate(unit[0])}
    pairs = [(k, place[key]) for k, d in enumerate(unit[1]) if (key := tuple(np.round(d * 5000).astype(int))) in place]
    error = np.array([np.linalg.norm(noisy.points[k]) - np.linalg.norm(turn.points[j]) for k, j in pairs])
    assert len(error) > 4000
    assert error.std() == pytest.approx(0.05, rel=0.05)
    assert abs(error.mean()) < 0.005


def test_two_scans_of_one_moment_are_alike(world: World, poses: list[np.ndarray], turn: LidarScan) -> None:
    again = scan(world, poses[0] @ T_CAM_LIDAR, 2.0, EXACT, np.random.default_rng(0))
    np.testing.assert_array_equal(again.points, turn.points)
    np.testing.assert_array_equal(again.instance, turn.instance)
