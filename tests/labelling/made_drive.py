"""A small made drive for the labelling's tests: keyframes, points, who saw what, and label images."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory
from wayloom.segmentation.scores import Scores

CAMERA = PinholeCamera(fx=90.0, fy=92.0, cx=49.3, cy=30.8, width=100, height=60)
RIG = StereoRig(CAMERA, (-0.5, 0.004, -0.003))


@dataclass
class HeldImages:
    """Label images in memory."""

    lefts: list[NDArray[np.uint8]]
    rights: list[NDArray[np.uint8]]
    likeliest: tuple[list[Scores], list[Scores]] | None = None
    smalls: list[NDArray[np.uint8]] | None = None
    """Of left and right alike."""
    may_be_void: bool = True
    is_balanced: bool = True

    def left(self, keyframe: int, /) -> NDArray[np.uint8]:
        return self.lefts[keyframe]

    def right(self, keyframe: int, /) -> NDArray[np.uint8]:
        return self.rights[keyframe]

    def scores(self, side: str, keyframe: int, /) -> Scores | None:
        return None if self.likeliest is None else self.likeliest[side == "right"][keyframe]

    def small(self, side: str, keyframe: int, /) -> NDArray[np.uint8]:
        assert self.smalls is not None
        return self.smalls[keyframe]


def texture(seed: int) -> NDArray[np.uint8]:
    """A small image of random grey values."""
    return np.random.default_rng(seed).integers(0, 255, (CAMERA.height // 2, CAMERA.width // 2)).astype(np.uint8)


def still_drive(keyframes: int = 5, points: int = 40, seed: int = 0) -> OdometryResult:
    """A drive that stands still: each point, hosted by keyframe 2, lies at its own pixel in every keyframe, and has no observer."""
    drive = made_drive(seed, keyframes, points)
    rng = np.random.default_rng(seed)
    alone = replace(
        drive.points,
        host=np.full(points, 2, np.int32),
        uv_host=rng.integers([8, 8], [CAMERA.width - 8, CAMERA.height - 8], (points, 2)).astype(np.float32),
        inverse_depth=np.full(points, 0.125, np.float32),
        obs_start=np.zeros(points + 1, np.int64),
        obs_keyframe=np.zeros(0, np.int32),
        obs_right=np.zeros(0, bool),
        host_right=np.zeros(points, bool),
    )
    at_rest = np.tile(np.eye(4), (keyframes, 1, 1))
    return replace(drive, points=alone, keyframes=replace(drive.keyframes, T_world_cam=at_rest))


def made_drive(seed: int, keyframes: int = 5, points: int = 120, bias_px: float = 0.4) -> OdometryResult:
    """A drive along a gentle bend, with points at 1 to 40 m, each seen by a random part of the keyframes."""
    rng = np.random.default_rng(seed)
    host = np.sort(rng.integers(0, keyframes, points)).astype(np.int32)
    seen_by = [sorted(rng.choice([j for j in range(keyframes) if j != h], rng.integers(0, keyframes), replace=False)) for h in host]
    start = np.concatenate([[0], np.cumsum([len(s) for s in seen_by])]).astype(np.int64)
    observers = np.array([j for s in seen_by for j in s], np.int32)
    return OdometryResult(
        rig=RIG,
        trajectory=Trajectory(
            np.arange(keyframes) * 10**8, poses(keyframes), np.ones(keyframes, bool), np.zeros(keyframes, np.int32)
        ),
        keyframes=Keyframes(
            np.arange(keyframes, dtype=np.int32), poses(keyframes), np.zeros((keyframes, 4)), np.zeros(keyframes, np.int32)
        ),
        points=Points(
            host=host,
            uv_host=rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (points, 2)).astype(np.float32),
            inverse_depth=(1 / rng.uniform(1, 40, points)).astype(np.float32),
            variance=np.full(points, 1e-4, np.float32),
            grey=np.zeros(points, np.uint8),
            obs_start=start,
            obs_keyframe=observers,
            obs_right=rng.random(len(observers)) < 0.7,
            host_right=rng.random(points) < 0.7,
        ),
        disparity_bias_px=bias_px,
        row_coefficients=np.array([0.3, -0.2, 0.8]),
    )


def poses(count: int) -> NDArray[np.float64]:
    """(count, 4, 4) T_world_cam: 0.8 m and 2 degrees a keyframe."""
    T = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        yaw = np.deg2rad(2.0 * k)
        T[k, :3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
        T[k, :3, 3] = [0.02 * k**2, 0, 0.8 * k]
    return T


def random_images(seed: int, keyframes: int = 5, classes: int = 4) -> HeldImages:
    """Blocky label images, a tenth of them void."""
    rng = np.random.default_rng(seed)

    def image() -> NDArray[np.uint8]:
        blocks = rng.integers(0, classes, (CAMERA.height // 4, CAMERA.width // 4)).astype(np.uint8)
        blocks[rng.random(blocks.shape) < 0.1] = 255
        return np.kron(blocks, np.ones((4, 4), np.uint8))

    return HeldImages([image() for _ in range(keyframes)], [image() for _ in range(keyframes)])


def even_images(label: int, keyframes: int = 5) -> HeldImages:
    """Label images of one class throughout."""
    image = np.full((CAMERA.height, CAMERA.width), label, np.uint8)
    return HeldImages([image] * keyframes, [image] * keyframes)
