"""Triangle meshes with semantic labels: built from quadrilaterals, transformed, recoloured and joined."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayloom.simulation.kernels.arrays import Triangles

F32 = NDArray[np.float32]
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Mesh:
    """T triangles; corners, uv, normals, material and tint as in `Triangles`.

    class_id  (T,) uint8 train id
    instance  (T,) int32 number of the thing it belongs to, 0 where it belongs to none
    """

    corners: F32
    uv: F32
    normals: F32
    material: NDArray[np.uint8]
    tint: F32
    class_id: NDArray[np.uint8]
    instance: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.material)

    def triangles(self) -> Triangles:
        """The arrays that the kernels render."""
        return Triangles(self.corners, self.uv, self.normals, self.material, self.tint)

    def rows(self, which: NDArray[np.int64] | slice) -> "Mesh":
        """The triangles chosen, in that order."""
        return Mesh(*(getattr(self, f.name)[which] for f in fields(self)))


def join(meshes: Iterable[Mesh]) -> Mesh:
    """All triangles of all meshes, in order."""
    parts = list(meshes)
    return Mesh(*(np.concatenate([getattr(m, f.name) for m in parts]) for f in fields(Mesh)))


def empty() -> Mesh:
    """A mesh without triangles."""
    corners = np.zeros((0, 3, 3), np.float32)
    none = np.zeros(0, np.uint8)
    return Mesh(corners, np.zeros((0, 3, 2), np.float32), corners, none, np.zeros((0, 3), np.float32), none, np.zeros(0, np.int32))


def placed(
    mesh: Mesh, x: float, y: float, yaw: float, z: float = 0.0, instance: int | None = None, scale: ArrayLike = WHITE
) -> Mesh:
    """A mesh modelled around its own origin (x forward, y left, z up), scaled, turned by yaw (rad) and put at (x, y, z) m."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
    corners = (mesh.corners * np.asarray(scale, np.float32)) @ R.T + np.array([x, y, z], np.float32)
    number = mesh.instance if instance is None else np.full(len(mesh), instance, np.int32)
    return replace(mesh, corners=corners, normals=mesh.normals @ R.T, instance=number)


def posed(mesh: Mesh, T_world_mesh: NDArray[np.float64], instance: int) -> Mesh:
    """The mesh moved by T_world_mesh (4, 4), as thing number `instance`."""
    R, t = T_world_mesh[:3, :3].astype(np.float32), T_world_mesh[:3, 3].astype(np.float32)
    number = np.full(len(mesh), instance, np.int32)
    return replace(mesh, corners=mesh.corners @ R.T + t, normals=mesh.normals @ R.T, instance=number)


def recoloured(mesh: Mesh, key: ArrayLike, tint: ArrayLike) -> Mesh:
    """The mesh with every triangle of tint `key` given another tint."""
    mine = np.all(mesh.tint == np.asarray(key, np.float32), axis=1)
    return replace(mesh, tint=np.where(mine[:, None], np.asarray(tint, np.float32), mesh.tint))


def cross(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Cross products of the rows of (N, 3) and (N, 3) or (3,); several times quicker than numpy's on short arrays."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


class MeshBuilder:
    """Collects quadrilaterals. Corners run counter-clockwise seen from outside; uv (0, 0) is a texture's top left.

    coarse: for what is far away; foliage is made of fewer, larger cards.
    """

    def __init__(self, coarse: bool = False) -> None:
        self.coarse = coarse
        self._parts: list[Mesh] = []

    def add(self, mesh: Mesh) -> None:
        """A finished mesh."""
        self._parts.append(mesh)

    def quads(
        self,
        corners: ArrayLike,
        uv: ArrayLike,
        material: int,
        class_id: int,
        instance: int = 0,
        tint: ArrayLike = WHITE,
        normals: ArrayLike | None = None,
    ) -> None:
        """corners (Q, 4, 3) m, uv (Q, 4, 2), tint (3,) or (Q, 3), normals (Q, 4, 3) or None for flat ones."""
        p = np.asarray(corners, np.float32).reshape(-1, 4, 3)
        t = np.asarray(uv, np.float32).reshape(-1, 4, 2)
        if normals is None:
            n = cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
            n = np.repeat((n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12))[:, None], 4, axis=1)
        else:
            n = np.asarray(normals, np.float32).reshape(-1, 4, 3)
        split = [0, 1, 2, 0, 2, 3]
        count = 2 * len(p)
        self._parts.append(
            Mesh(
                p[:, split].reshape(count, 3, 3),
                t[:, split].reshape(count, 3, 2),
                n[:, split].reshape(count, 3, 3).astype(np.float32),
                np.full(count, material, np.uint8),
                np.repeat(np.broadcast_to(np.asarray(tint, np.float32), (len(p), 3)), 2, axis=0),
                np.full(count, class_id, np.uint8),
                np.full(count, instance, np.int32),
            )
        )

    def fan(self, centre: ArrayLike, rim: ArrayLike, metres: float, material: int, class_id: int, instance: int = 0) -> None:
        """Flat triangles from centre (3,) to the rim (R, 3), in order; uv along x and y from the centre, `metres` a repeat."""
        c, r = np.asarray(centre, np.float32), np.asarray(rim, np.float32)
        first, second = r[:-1], r[1:]
        corners = np.stack([np.broadcast_to(c, first.shape), first, second, second], axis=1)
        self.quads(corners, (corners - c)[..., :2] / metres, material, class_id, instance)

    def build(self) -> Mesh:
        """Everything collected, in order."""
        return join(self._parts) if self._parts else empty()
