"""Scene: a place view prepared for registration, with surfaces, free space and bird's-eye layers."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.labelling.neighbours import nearest
from wayloom.places.types import PlaceView
from wayloom.registration.kernels.rays import blow_up, carve
from wayloom.registration.kernels.surfaces import surface_covariances
from wayloom.registration.ray_sigmas import sigmas_beside
from wayloom.registration.settings import RegistrationSettings

FloatArray = NDArray[np.float64]
GROUPS: Final = (
    ("road", "sidewalk", "terrain"),
    ("building", "wall", "fence"),
    ("pole", "traffic light", "traffic sign"),
    ("vegetation",),
)
"""Classes that a network takes for each other; points fit points of their own group only."""
GROUND, STRUCTURE, POLES, VEGETATION = range(len(GROUPS))
VOXEL_M: Final = 0.5
HALF_WIDTH_M: Final = 64.0
BELOW_M, ABOVE_M = 8.0, 24.0
CELL_M: Final = 1.5
LATERAL_SIGMA_M: Final = 0.04
"""Noise of a point across its ray."""
LEAST_SURFACE_M, MOST_SURFACE_M = 0.03, 0.5
SURFACE_NEIGHBOURS: Final = 10
SURFACE_RADIUS_M: Final = 1.5
THIN_M: Final = 0.5
BAND_M: Final = (-1.0, 1.0)
"""Heights, from the camera's, at which free and occupied cells are compared."""
FREE_LINES: Final = 3
"""Lines of sight that make a voxel free."""
FREE: Final = 0x80
NOT_GROUND: Final = 0x7F ^ (1 << GROUND)
NEAR: Final = 0x7F
OCCUPIED_VOXELS: Final = 2
"""A line of sight proves nothing within so many voxels of a point."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Points sorted into cubes: origin (3,) m, size_m, shape (3,) int64, start (C + 1,) and order (N,) int64."""

    origin: FloatArray
    size_m: float
    shape: NDArray[np.int64]
    start: NDArray[np.int64]
    order: NDArray[np.int64]

    def arrays(self) -> tuple[Any, ...]:
        """As the kernels take them."""
        return self.origin, self.size_m, self.shape, self.start, self.order


@dataclass(frozen=True, slots=True)
class Scene:
    """A prepared view, N points in its level frame, the surest of each cube of THIN_M; all points of the view make the voxels.

    xyz      (N, 3) m
    group    (N,) int8 row of GROUPS
    noise    (N, 3, 3) m^2
    surface  (N, 3, 3) m^2: shape of the surface and noise of the point
    sigma_m  (N,) along the ray
    rays     (N, 3) unit, from the camera that hosts the point
    origin   (3,) m, lower corner of the voxels
    voxels   (X, Y, Z) uint8 bits of the groups that have points nearby, and FREE where lines of sight pass
    free_cells  (M, 3) m centres of the voxels' columns that are free in BAND_M; z is 0
    """

    view: PlaceView
    xyz: FloatArray
    group: NDArray[np.int8]
    surface: FloatArray
    sigma_m: FloatArray
    rays: FloatArray
    cells: Cells
    origin: FloatArray
    voxels: NDArray[np.uint8]
    free_cells: FloatArray

    def __len__(self) -> int:
        return len(self.xyz)

    def points(self) -> tuple[Any, ...]:
        """As the fitting kernel takes them."""
        return self.xyz, self.group, self.surface


def group_of_label() -> NDArray[np.int8]:
    """(256,) int8 group of each train id, -1 for classes that take no part."""
    table = np.full(256, -1, np.int8)
    for number, names in enumerate(GROUPS):
        table[[CLASS_ID[name] for name in names]] = number
    return table


def prepare(view: PlaceView, settings: RegistrationSettings) -> Scene:
    """A view's points of useful classes and certainty, with what registration needs of them."""
    group = group_of_label()[view.label]
    within = np.linalg.norm(view.xyz[:, :2], axis=1) < settings.radius_m
    kept = np.flatnonzero((group >= 0) & within & (view.sigma_m < settings.max_point_sigma_m) & (np.abs(view.xyz[:, 2]) < ABOVE_M))
    xyz, group, sigma_m = view.xyz[kept].astype(np.float64), group[kept], view.sigma_m[kept].astype(np.float64)
    cameras = view.cameras[view.camera[kept]]
    sigma_m = sigmas_beside(xyz - cameras, sigma_m, view.camera[kept], group)
    origin = np.array([-HALF_WIDTH_M, -HALF_WIDTH_M, -BELOW_M])
    shape = tuple(int(n) for n in np.array([2 * HALF_WIDTH_M, 2 * HALF_WIDTH_M, BELOW_M + ABOVE_M]) / VOXEL_M)
    free, near = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    carve(cameras, xyz, 1.0 + 2.0 * sigma_m, origin, VOXEL_M, free)
    blow_up(xyz, group, OCCUPIED_VOXELS, origin, VOXEL_M, near)
    voxels = near | np.where(free >= FREE_LINES, np.uint8(FREE), np.uint8(0))
    noise = ray_noise(xyz - cameras, sigma_m)
    surface = surfaces(xyz, group, noise) + noise
    rows = thinned(xyz, group, sigma_m)
    rays = directions(xyz[rows] - cameras[rows])
    xyz = np.ascontiguousarray(xyz[rows])
    cells = cells_of(xyz)
    return Scene(view, xyz, group[rows], surface[rows], sigma_m[rows], rays, cells, origin, voxels, free_cells(voxels, origin))


def thinned(xyz: FloatArray, group: NDArray[np.int8], sigma_m: FloatArray) -> NDArray[np.int64]:
    """Rows of the surest point of each group in each cube of THIN_M, increasing; of equals the first."""
    i, j, k = (np.floor(xyz / THIN_M).astype(np.int64) + 512).T
    cube = ((i * 1024 + j) * 1024 + k) * len(GROUPS) + group
    order = np.lexsort((sigma_m, cube))
    first = np.ones(len(order), bool)
    first[1:] = cube[order[1:]] != cube[order[:-1]]
    chosen: NDArray[np.int64] = np.sort(order[first])
    return chosen


def free_cells(voxels: NDArray[np.uint8], origin: FloatArray) -> FloatArray:
    """(M, 3) m centres, z 0, of the columns of voxels that lines of sight pass at BAND_M and that nothing but ground is near."""
    low, high = (int((z - origin[2]) / VOXEL_M) for z in BAND_M)
    band = np.bitwise_or.reduce(voxels[:, :, low:high], axis=2)
    cells = np.argwhere((band & (FREE | NOT_GROUND)) == FREE)
    return np.column_stack([(cells + 0.5) * VOXEL_M + origin[:2], np.zeros(len(cells))])


def directions(rays: FloatArray) -> FloatArray:
    """(N, 3) unit, of rays (N, 3) m; of none where one has no length."""
    return np.asarray(rays / np.maximum(np.linalg.norm(rays, axis=1), 1e-9)[:, None])


def ray_noise(rays: FloatArray, sigma_m: FloatArray) -> FloatArray:
    """(N, 3, 3) m^2 covariance of points at the ends of rays (N, 3) with sigma_m (N,) along them."""
    direction = directions(rays)
    along = np.einsum("ni,nj->nij", direction, direction)
    covariance: FloatArray = along * (sigma_m**2)[:, None, None] + LATERAL_SIGMA_M**2 * np.eye(3)
    return covariance


def surfaces(xyz: FloatArray, group: NDArray[np.int8], noise: FloatArray) -> FloatArray:
    """(N, 3, 3) m^2 shape of the surface around each point, from neighbours of its own group."""
    out = np.zeros((len(xyz), 3, 3))
    for number in range(len(GROUPS)):
        rows = np.flatnonzero(group == number)
        if len(rows):
            near, _ = nearest(xyz[rows], np.full(len(rows), SURFACE_RADIUS_M), SURFACE_NEIGHBOURS)
            part = np.empty((len(rows), 3, 3))
            surface_covariances(xyz[rows], near, noise[rows], LEAST_SURFACE_M, MOST_SURFACE_M, part)
            out[rows] = part
    return out


def cells_of(xyz: FloatArray) -> Cells:
    """The points by cubes of CELL_M."""
    if not len(xyz):
        return Cells(np.zeros(3), CELL_M, np.ones(3, np.int64), np.zeros(2, np.int64), np.zeros(0, np.int64))
    origin = xyz.min(axis=0)
    index = ((xyz - origin) // CELL_M).astype(np.int64)
    shape = index.max(axis=0) + 1
    cell = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(int(np.prod(shape)) + 1))
    return Cells(origin, CELL_M, shape, start, order)
