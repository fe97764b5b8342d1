"""A street made of textured planes with exact poses and depths, and a drive log that shows it."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.types import NOTHING_STATED, StereoFrame

FloatArray = NDArray[np.float64]
CAMERA = PinholeCamera(200.0, 200.0, 159.5, 99.5, 320, 200)
RIG = StereoRig(CAMERA, (-0.5, 0.0, 0.0))
TEXELS_PER_M = 12.0
KEPT = 500
"""Pairs of images: as many as the longest drive that is tracked more than once has frames, and some."""
# (normal, distance): planes n.p = d in the world, x right, y down, z forward
PLANES = (((0.0, 1.0, 0.0), 1.5), ((1.0, 0.0, 0.0), 4.0), ((-1.0, 0.0, 0.0), 5.0), ((0.0, 0.0, 1.0), 45.0), ((0.0, -1.0, 0.0), 7.0))


def texture(seed: int) -> NDArray[np.float32]:
    """(1024, 1024) grey levels 20 to 230 with detail at several scales; repeats without a seam."""
    rng = np.random.default_rng(seed)
    out = np.zeros((1024, 1024), np.float32)
    for size, weight in ((32, 0.5), (128, 0.7), (512, 1.0), (1024, 0.6)):
        coarse = rng.normal(size=(size, size)).astype(np.float32)
        padded = np.pad(coarse, 2, mode="wrap")
        scale = 1024 // size
        large = cv2.resize(padded, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        out += weight * large[2 * scale : -2 * scale, 2 * scale : -2 * scale]
    return np.clip(125.0 + 45.0 * cv2.GaussianBlur(out, (0, 0), 1.0), 20, 230).astype(np.float32)


TEXTURES = [texture(i) for i in range(len(PLANES))]


def render(T_world_cam: FloatArray, camera: PinholeCamera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Image (h, w) float64 grey levels and inverse depth (h, w) 1/m."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()])) @ T_world_cam[:3, :3].T
    origin = T_world_cam[:3, 3]
    best, image = np.zeros(len(rays)), np.zeros(len(rays))
    for (normal, distance), plane in zip(PLANES, TEXTURES, strict=True):
        n = np.array(normal)
        rho = rays @ n / (distance - origin @ n)
        nearer = rho > best
        points = origin + rays[nearer] / rho[nearer, None]
        axes = [axis for axis in range(3) if n[axis] == 0.0]
        st = (points[:, axes] * TEXELS_PER_M) % 1024
        image[nearer] = bilinear(plane, st[:, 0], st[:, 1])
        best[nearer] = rho[nearer]
    return image.reshape(u.shape), best.reshape(u.shape)


def bilinear(plane: NDArray[np.float32], s: FloatArray, t: FloatArray) -> FloatArray:
    i, j = np.floor(s).astype(int), np.floor(t).astype(int)
    a, b = s - i, t - j
    i, j, i1, j1 = i % 1024, j % 1024, (i + 1) % 1024, (j + 1) % 1024
    low = (1 - a) * plane[j, i] + a * plane[j, i1]
    return np.asarray((1 - b) * low + b * ((1 - a) * plane[j1, i] + a * plane[j1, i1]))


def pair(T_world_cam: FloatArray, rig: StereoRig = RIG, bias_px: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left and right image (h, w) float64 and the left one's inverse depth. bias_px: u_right = u_left - bf rho - bias."""
    left, rho = render(T_world_cam, rig.camera)
    T_left_right = np.eye(4)
    T_left_right[:3, 3] = -np.array(rig.t_right_left)
    shifted = replace(rig.camera, cx=rig.camera.cx - bias_px)
    return left, render(T_world_cam @ T_left_right, shifted)[0], rho


def grey(image: FloatArray) -> NDArray[np.uint8]:
    """(h, w) uint8 of grey levels, which nobody changes."""
    rounded = np.clip(np.round(image), 0, 255).astype(np.uint8)
    rounded.flags.writeable = False
    return rounded


@lru_cache(KEPT)
def grey_pair(pose: bytes, rig: StereoRig, bias_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Left and right image of a pose (4, 4) as bytes: most tests drive the same curve, many of them twice."""
    left, right, _ = pair(np.frombuffer(pose).reshape(4, 4), rig, bias_px)
    return grey(left), grey(right)


def curve(frames: int, step_m: float = 0.4, yaw_step: float = 0.004) -> FloatArray:
    """(frames, 4, 4) T_world_cam along a gentle curve with some nodding."""
    poses, T = [], np.eye(4)
    for i in range(frames):
        poses.append(T)
        T = T @ se3.exp(np.array([0.0, 0.0, step_m, 0.002 * np.sin(i), yaw_step * np.cos(0.2 * i), 0.001 * np.cos(i)]))
    return np.array(poses).reshape(-1, 4, 4)


@dataclass
class MadeLog:
    """A drive log of the made street; `changes` maps a frame to a function of its (left, right) uint8 images."""

    truth: FloatArray
    rig: StereoRig = RIG
    bias_px: float = 0.0
    colour: bool = False
    changes: dict = field(default_factory=dict)
    t_ns: NDArray[np.int64] = field(init=False)
    path: Path = Path("made")
    format: str = "made"
    name: str = "made"
    gnss = None
    imu = None
    p_cam_gnss = np.zeros(3)
    receiver = NOTHING_STATED
    T_cam_imu = None
    rig_id = None
    vehicle_id = None
    missing: tuple[str, ...] = ()
    root: Path = Path("made")
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.t_ns = np.arange(len(self.truth), dtype=np.int64) * 100_000_000

    def __len__(self) -> int:
        return len(self.truth)

    def drawn(self, index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Left and right image of the street as it always is: nobody changes them."""
        return grey_pair(self.truth[index].tobytes(), self.rig, self.bias_px)

    def frame(self, index: int) -> StereoFrame:
        left8, right8 = (image.copy() for image in self.drawn(index))
        if index in self.changes:
            left8, right8 = self.changes[index](left8, right8)
        if self.colour:
            left8, right8 = (np.repeat(image[..., None], 3, axis=2) for image in (left8, right8))
        return StereoFrame(index, int(self.t_ns[index]), left8, right8)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        for index in range(start, len(self) if stop is None else stop):
            yield self.frame(index)


@dataclass
class CountingLog(MadeLog):
    """Counts how often each image is decoded."""

    decoded: Counter[tuple[int, bool]] = field(default_factory=Counter)

    def grey_side(self, index: int, right: bool) -> NDArray[np.uint8]:
        self.decoded[index, right] += 1
        frame = self.frame(index)
        return frame.right if right else frame.left
