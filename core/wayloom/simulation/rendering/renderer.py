"""Renderer: radiance, depth, class and instance images of the city for a camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import SKY
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.simulation.city.city import City
from wayloom.simulation.kernels import raster, shade
from wayloom.simulation.kernels.arrays import Light, TextureStack, View
from wayloom.simulation.models.mesh import Mesh, empty, join
from wayloom.simulation.rendering.light import MOVER_REACH_M, CityLight
from wayloom.simulation.rendering.rain import with_rain
from wayloom.simulation.traffic.traffic import Traffic

F64 = NDArray[np.float64]
FAR_M = 700.0
STEREO_MARGIN_M = 1.0
SAMPLES_PER_EDGE = 2


@dataclass(frozen=True, slots=True)
class Truth:
    """depth (h, w) float32 m along z, 0 for sky; class_id (h, w) uint8 train ids; instance (h, w) uint16, 0 for none."""

    depth: NDArray[np.float32]
    class_id: NDArray[np.uint8]
    instance: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Scene:
    """Renderable scene at one moment t_s: triangles that may be visible, nearest chunks first, light, and rain."""

    mesh: Mesh
    light: Light
    textures: TextureStack
    rain_mm_h: float = 0.0
    t_s: float = 0.0

    def image(self, camera: PinholeCamera, T_world_cam: F64) -> NDArray[np.float32]:
        """(h, w, 3) linear radiance, four samples of coverage a pixel."""
        return self.shaded(self.fine_ids(camera, T_world_cam), camera, T_world_cam)

    def fine_ids(self, camera: PinholeCamera, T_world_cam: F64) -> NDArray[np.int32]:
        """(2 h, 2 w) row of the triangle that each of a pixel's four samples sees: sample 2 u + 0.5 lies on pixel u's centre."""
        n = SAMPLES_PER_EDGE
        fine = View(n * camera.fx, n * camera.fy, n * camera.cx + 0.5 * (n - 1), n * camera.cy + 0.5 * (n - 1), T_world_cam)
        return self.ids(fine, n * camera.width, n * camera.height)

    def shaded(self, fine_ids: NDArray[np.int32], camera: PinholeCamera, T_world_cam: F64) -> NDArray[np.float32]:
        """(h, w, 3) linear radiance of what `fine_ids` says is seen."""
        out, view = np.empty((camera.height, camera.width, 3), np.float32), _view(camera, T_world_cam)
        shade.shade_samples(fine_ids, self.mesh.triangles(), self.textures, self.light, view, out, *_scratch())
        if self.rain_mm_h > 0:
            return with_rain(out, camera, T_world_cam, self.rain_mm_h, self.t_s, self.light.horizon_rgb)
        return out

    def truth(self, camera: PinholeCamera, T_world_cam: F64) -> Truth:
        """Ground truth of the ray through each pixel's centre."""
        view = _view(camera, T_world_cam)
        ids = self.ids(view, camera.width, camera.height)
        depth = np.empty(ids.shape, np.float32)
        raster.depth_of(ids, view, self.mesh.corners, depth)
        seen = ids != raster.NO_TRIANGLE
        return Truth(
            depth,
            np.where(seen, self.mesh.class_id[ids], SKY).astype(np.uint8),
            np.where(seen, self.mesh.instance[ids], 0).astype(np.uint16),
        )

    def ids(self, view: View, width: int, height: int) -> NDArray[np.int32]:
        """(height, width) row of the triangle that each sample sees."""
        return triangle_ids(self.mesh, self.textures, view, width, height)


def triangle_ids(mesh: Mesh, textures: TextureStack, view: View, width: int, height: int) -> NDArray[np.int32]:
    """(height, width) row of the mesh's triangle that each pixel of a view sees, NO_TRIANGLE where none."""
    edges, boxes = np.empty((len(mesh), 9)), np.empty((len(mesh), 4), np.int32)
    raster.project_triangles(mesh.corners, view, se3.inverse(view.T_world_cam), width, height, edges, boxes, np.empty((3, 3)))
    inv_z, ids = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
    raster.rasterise(edges, boxes, mesh.triangles(), textures, inv_z, ids)
    return ids


@dataclass(frozen=True, slots=True)
class World:
    """A city with its traffic, its textures and its light."""

    city: City
    traffic: Traffic
    textures: TextureStack
    light: CityLight

    def scene(self, camera: PinholeCamera, T_world_cam: F64, t_s: float, left_out: frozenset[int] = frozenset()) -> Scene:
        """The scene that a stereo pair with its left camera about T_world_cam may see at time t_s, without some movers."""
        x, y = float(T_world_cam[0, 3]), float(T_world_cam[1, 3])
        planes, reach = view_planes(camera, T_world_cam)
        movers = self.traffic.around(x, y, t_s, left_out)
        in_view = [bool(np.all(planes @ (m.centre - T_world_cam[:3, 3]) > -(reach + m.radius_m))) for m in movers]
        shading = [bool(np.hypot(m.centre[0] - x, m.centre[1] - y) < MOVER_REACH_M + m.radius_m) for m in movers]
        placed = [(m.mesh, a, b) for m, a, b in zip(movers, in_view, shading, strict=True) if a or b]
        seen, casters = [mesh for mesh, a, _ in placed if a], [mesh for mesh, _, b in placed if b]
        chunks = self.city.visible(planes, reach, T_world_cam[:3, 3])
        light = self.light.at(x, y, join(casters) if casters else empty())
        return Scene(join([*seen, self.city.chunks(chunks)]), light, self.textures, self.light.settings.rain_mm_h, t_s)


def view_planes(camera: PinholeCamera, T_world_cam: F64) -> tuple[F64, F64]:
    """Inward unit normals (6, 3) of the view's four sides, of its front and its far end, in the world, and how far outside of
    each, seen from the camera, a stereo pair still sees, m (6,)."""
    left, right = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    top, bottom = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    planes_cam = np.array([(1, 0, -left), (-1, 0, right), (0, 1, -top), (0, -1, bottom), (0, 0, 1), (0, 0, -1)])
    planes_cam /= np.linalg.norm(planes_cam, axis=1, keepdims=True)
    reach = np.full(6, STEREO_MARGIN_M)
    reach[5] = FAR_M
    return planes_cam @ T_world_cam[:3, :3].T, reach


def _scratch() -> tuple[NDArray[np.int32], F64]:
    return np.empty((2, 4), np.int32), np.empty((2, 4))


def _view(camera: PinholeCamera, T_world_cam: F64) -> View:
    return View(camera.fx, camera.fy, camera.cx, camera.cy, T_world_cam)
