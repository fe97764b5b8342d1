"""Made drives past a wall with a pole before it, with looks that are drawn from the scene."""

from dataclasses import dataclass

import numpy as np

from submaps.made_submaps import FRAME
from wayloom.dense.types import BUILT, DEPTHS_M, KINDS_OF_CLASS, MOVING, Looks
from wayloom.geometry.camera import PinholeCamera
from wayloom.stitching.placed_looks import PlacedLooks, place_looks
from wayloom.submaps.submap import PlacedSubmap, Submap

CAMERA = PinholeCamera(80.0, 80.0, 87.5, 23.5, 176, 48)
WALL_M, POLE_M, CAR_M = 12.0, 6.0, 3.0
"""East of the way."""
POLE_NORTH, POLE_HALF_M = 10.0, 0.2
BUILDING, POLE = 2, 5
SIGMA = 0.5 / 95.0
DAY_NS = 86_400 * 10**9
R_MAP_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Cameras look east, at the wall."""


@dataclass(frozen=True)
class Passing:
    """One drive along the wall: number of its day, whether the pole stands, is labelled, has points and how many, of which class;
    a car that hides it."""

    day: int
    pole: bool = True
    labelled: bool | None = None
    has_points: bool | None = None
    points: int = 6
    label: int = POLE
    hidden: bool = False
    sigma_m: float = 0.02
    north: tuple[float, ...] = tuple(np.arange(0.0, 20.0, 2.0).tolist())
    place: tuple[float, float] = (0.0, 0.0)

    @property
    def drive_id(self) -> str:
        return f"day-{self.day}"


def codes(depth):
    near = np.searchsorted(DEPTHS_M, depth, side="right")
    return near.astype(np.uint8), (np.searchsorted(DEPTHS_M, depth, side="left") + 1).astype(np.uint8)


def drawn(way: Passing) -> Looks:
    """What the drive saw: wall, pole where it stands, a car before all of it where it is hidden."""
    north_of_pixel = -(np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    depth = np.full((len(way.north), CAMERA.height, CAMERA.width), WALL_M)
    kinds = np.full(depth.shape, BUILT, np.uint8)
    labelled = way.pole if way.labelled is None else way.labelled
    for row, at in enumerate(way.north):
        is_pole = np.abs(at + POLE_M * north_of_pixel - POLE_NORTH) < POLE_HALF_M
        if way.pole:
            depth[row][:, is_pole] = POLE_M
        if labelled:
            kinds[row][:, is_pole] = KINDS_OF_CLASS[way.label]
        if way.hidden:
            depth[row], kinds[row] = CAR_M, MOVING
    near, far = codes(depth)
    return Looks(CAMERA, SIGMA, np.arange(len(way.north), dtype=np.uint32), near, far, kinds)


def driven(way: Passing) -> PlacedSubmap:
    """The drive's points of wall and pole."""
    rng = np.random.default_rng(way.day)
    wall = np.column_stack([np.full(300, WALL_M), rng.uniform(0.0, 20.0, 300), rng.uniform(-1.0, 3.0, 300)])
    has_points = way.pole and not way.hidden if way.has_points is None else way.has_points
    pole = np.column_stack([rng.normal(POLE_M, 0.02, 6), rng.normal(POLE_NORTH, 0.02, 6), np.linspace(-1.0, 1.0, 6)])
    pole = pole[: way.points * has_points]
    xyz = np.concatenate([wall, pole])
    label = np.repeat(np.array([BUILDING, way.label], np.uint8), [300, len(pole)])
    T = np.tile(np.eye(4), (len(way.north), 1, 1))
    T[:, :3, :3], T[:, 1, 3] = R_MAP_CAM, way.north
    t_ns = 10**18 + way.day * DAY_NS + np.arange(len(way.north)) * 10**9
    host = np.zeros(len(xyz), np.int64)
    submap = Submap(
        xyz.astype(np.float32), label, np.full(len(xyz), 0.03**2, np.float32), np.zeros(len(xyz), np.uint8), t_ns[host],
        host.astype(np.uint32), np.zeros(len(xyz) + 1, np.uint32), np.zeros(0, np.uint8), np.zeros(0, np.float32),
        np.arange(len(way.north), dtype=np.uint32), t_ns, T, 20.0, {},
    )  # fmt: skip
    T_enu_submap = np.eye(4)
    T_enu_submap[:2, 3] = way.place
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.eye(3) * way.sigma_m**2
    return PlacedSubmap(submap, T_enu_submap, covariance, way.drive_id, FRAME)


def seen(way: Passing) -> PlacedLooks:
    """Its looks where its submap lies."""
    return place_looks(driven(way), drawn(way))
