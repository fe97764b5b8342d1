"""Spinning LiDAR model: range, class and instance of each shot, by ray intersection with the scene's triangles.

The turn is drawn as four pinhole views of the rasteriser's truth, finer than the shots lie apart; each shot then meets the plane of
the triangle that it sees there exactly. A scan is that of one moment: as if the motion during the turn had been undone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera
from wayloom.simulation.kernels import optics as kernels
from wayloom.simulation.kernels import raster
from wayloom.simulation.kernels.arrays import TextureStack, View
from wayloom.simulation.models.mesh import Mesh, join
from wayloom.simulation.rendering.renderer import World, triangle_ids, view_planes
from wayloom.simulation.traffic.traffic import PlacedModel
from wayloom.simulation.vehicle.vehicle_settings import AXES_CAM_BODY, LidarSettings

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
VIEWS: Final = 4
FINER: Final = 1.25
"""Pixels of a view for each step between shots, in its middle; towards its sides there are more."""
ROWS_PER_RING: Final = 5.0
MARGIN_PX: Final = 2
GLANCING: Final = 0.06
"""Cosine of incidence at which half of the shots are lost."""


@dataclass(frozen=True, slots=True)
class LidarScan:
    """Points of one turn, ring by ring.

    points       (N, 3) float32 m in the LiDAR's frame: x forward, y left, z up
    reflectance  (N,) float32 0 to 1
    class_id     (N,) uint8 train ids
    instance     (N,) uint16, 0 for none
    ring         (N,) uint8, 0 the highest
    """

    points: F32
    reflectance: F32
    class_id: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    ring: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Shots:
    """Hits of one view: directions (N, 3) in the LiDAR's frame, range m, triangle row, ring."""

    direction: F64
    range_m: F64
    triangle: NDArray[np.int64]
    ring: NDArray[np.int64]


def scan(
    world: World,
    T_enu_lidar: F64,
    t_s: float,
    settings: LidarSettings,
    rng: np.random.Generator,
    left_out: frozenset[int] = frozenset(),
) -> LidarScan:
    """One turn at time t_s from T_enu_lidar (4, 4), without some movers."""
    parts = []
    movers = world.traffic.around(float(T_enu_lidar[0, 3]), float(T_enu_lidar[1, 3]), t_s, left_out)
    for k in range(VIEWS):
        camera, T_lidar_view = _view(settings, k)
        mesh = _within_reach(world, camera, T_enu_lidar @ T_lidar_view, movers, settings.farthest_m)
        shots = _shots(mesh, world.textures, camera, T_enu_lidar, T_lidar_view, settings, k)
        parts.append(_measured(mesh, shots, T_enu_lidar, settings, rng))
    joined = LidarScan(*(np.concatenate([getattr(p, name) for p in parts]) for name in LidarScan.__slots__))
    order = np.argsort(joined.ring, kind="stable")
    return LidarScan(*(getattr(joined, name)[order] for name in LidarScan.__slots__))


def _view(settings: LidarSettings, number: int) -> tuple[PinholeCamera, F64]:
    """The pinhole camera of one quarter of the turn, and T_lidar_view (4, 4)."""
    side = np.tan(np.pi / VIEWS)
    fx = FINER * settings.columns / (2 * np.pi)
    step_deg = (settings.highest_deg - settings.lowest_deg) / max(settings.rings - 1, 1)
    fy = ROWS_PER_RING / np.radians(max(step_deg, 0.1)) * 0.5
    low, high = (np.tan(np.radians(d)) / np.cos(np.pi / VIEWS) for d in (settings.lowest_deg, settings.highest_deg))
    width, height = int(np.ceil(2 * fx * side)) + 2 * MARGIN_PX + 1, int(np.ceil(fy * (high - low))) + 2 * MARGIN_PX + 1
    camera = PinholeCamera(float(fx), float(fy), float(fx * side) + MARGIN_PX, float(fy * high) + MARGIN_PX, width, height)
    azimuth = 2 * np.pi * number / VIEWS
    c, s = np.cos(azimuth), np.sin(azimuth)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ AXES_CAM_BODY.T
    return camera, T


def directions(settings: LidarSettings, number: int) -> tuple[F64, NDArray[np.int64]]:
    """(N, 3) unit directions of the shots of one quarter, in the LiDAR's frame, and their ring (N,)."""
    azimuth = 2 * np.pi * (np.arange(settings.columns) + 0.5) / settings.columns - np.pi
    quarter = np.floor(azimuth / (2 * np.pi / VIEWS) + 0.5).astype(int) % VIEWS
    a = azimuth[quarter == number]
    elevation = np.radians(np.linspace(settings.highest_deg, settings.lowest_deg, settings.rings))
    e, a = (x.ravel() for x in np.meshgrid(elevation, a, indexing="ij"))
    ring = np.repeat(np.arange(settings.rings), int((quarter == number).sum()))
    return np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]), ring


def _within_reach(world: World, camera: PinholeCamera, T_world_view: F64, movers: list[PlacedModel], reach_m: float) -> Mesh:
    """Static and moving triangles within a view and no farther than reach_m."""
    planes, reach = view_planes(camera, T_world_view)
    reach[-1] = reach_m
    origin = T_world_view[:3, 3]
    moving = [m.mesh for m in movers if np.all(planes @ (m.centre - origin) > -(reach + m.radius_m))]
    return join([*moving, world.city.chunks(world.city.visible(planes, reach, origin))])


def _shots(
    mesh: Mesh, textures: TextureStack, camera: PinholeCamera, T_enu_lidar: F64, T_lidar_view: F64, settings: LidarSettings,
    number: int,
) -> _Shots:  # fmt: skip
    """Hits of the shots of one quarter within the scanner's reach."""
    direction, ring = directions(settings, number)
    rays = direction @ T_lidar_view[:3, :3]
    uv = camera.project(rays)
    view = View(camera.fx, camera.fy, camera.cx, camera.cy, T_enu_lidar @ T_lidar_view)
    ids = triangle_ids(mesh, textures, view, camera.width, camera.height)
    place = np.rint(uv).astype(np.int64)
    seen = ids[place[:, 1], place[:, 0]]
    depth = np.empty(len(seen), np.float32)
    u, v = (np.ascontiguousarray(uv[:, k], np.float32) for k in (0, 1))
    kernels.depth_along(seen, u, v, view, mesh.corners, depth)
    range_m = depth / rays[:, 2]
    kept = (seen != raster.NO_TRIANGLE) & (range_m > settings.nearest_m) & (range_m < settings.farthest_m)
    return _Shots(direction[kept], range_m[kept], seen[kept].astype(np.int64), ring[kept])


def _measured(mesh: Mesh, shots: _Shots, T_enu_lidar: F64, settings: LidarSettings, rng: np.random.Generator) -> LidarScan:
    """Hits with range noise, less those that give no echo."""
    corners = mesh.corners[shots.triangle].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ T_enu_lidar[:3, :3]
    cosine = np.abs(np.sum(normal * shots.direction, axis=1)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    kept = rng.random(len(cosine)) < (1 - settings.dropout) * cosine / (cosine + GLANCING) * (1 + GLANCING)
    range_m = shots.range_m + rng.normal(size=len(cosine)) * settings.range_noise_m
    triangle = shots.triangle[kept]
    reflectance = np.clip(cosine[kept] * mesh.tint[triangle].mean(axis=1) * 0.6, 0, 1)
    return LidarScan(
        (shots.direction[kept] * range_m[kept, None]).astype(np.float32),
        reflectance.astype(np.float32),
        mesh.class_id[triangle].astype(np.uint8),
        mesh.instance[triangle].astype(np.uint16),
        shots.ring[kept].astype(np.uint8),
    )
