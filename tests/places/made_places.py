"""A made drive along a street of textured planes, whose poses, depths and classes are known, and places of any content."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.made_street import CAMERA, RIG, MadeLog, curve, render
from wayloom.config.classes import CLASS_ID
from wayloom.geometry.camera import StereoRig
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory
from wayloom.places.types import PlaceCloud, PlaceFeatures, Places

SKY, CAR, BUILDING = CLASS_ID["sky"], CLASS_ID["car"], CLASS_ID["building"]
SKY_ROWS, CAR_COLUMNS = 20, 60
"""The uppermost rows are called sky and the first columns a car, wherever the camera looks."""


@dataclass
class MadeLabels:
    """The same label image at every keyframe."""

    image: NDArray[np.uint8]

    def left(self, keyframe: int, /) -> NDArray[np.uint8]:
        return self.image


def label_image() -> NDArray[np.uint8]:
    """Building, with some sky and a car."""
    image = np.full((CAMERA.height, CAMERA.width), BUILDING, np.uint8)
    image[:, :CAR_COLUMNS] = CAR
    image[:SKY_ROWS] = SKY
    return image


def made_drive(frames: int = 12, points: int = 40, rig: StereoRig = RIG) -> tuple[MadeLog, OdometryResult, PointLabels, MadeLabels]:
    """A log of the street, and what perfect stages would leave of it: every frame a keyframe that hosts `points` points."""
    log = MadeLog(curve(frames, step_m=1.01), rig)
    rng = np.random.default_rng(3)
    hosts = np.repeat(np.arange(frames, dtype=np.int32), points)
    uv = rng.integers([0, 0], [CAMERA.width, CAMERA.height], (len(hosts), 2))
    rho = np.array([render(T, CAMERA)[1] for T in log.truth])[hosts, uv[:, 1], uv[:, 0]]
    none = np.zeros(len(hosts) + 1, np.int64)
    hosted = Points(
        hosts, uv.astype(np.float32), rho.astype(np.float32), np.full(len(hosts), 1e-8, np.float32), np.zeros(len(hosts), np.uint8),
        none, np.zeros(0, np.int32), np.zeros(0, bool), np.ones(len(hosts), bool),
    )  # fmt: skip
    still = np.zeros(frames, np.int32)
    odometry = OdometryResult(
        rig, Trajectory(log.t_ns, log.truth, np.ones(frames, bool), still),
        Keyframes(np.arange(frames, dtype=np.int32), log.truth, np.zeros((frames, 4)), still), hosted, 0.0, np.zeros(3),
    )  # fmt: skip
    image = label_image()
    own = image[uv[:, 1], uv[:, 0]]
    labels = PointLabels(own, own, own, none, np.zeros(0, np.uint8), np.zeros(0, np.float32))
    return log, odometry, labels, MadeLabels(image)


def random_places(seed: int, keyframes: int = 30, step_m: float = 1.0) -> Places:
    """Features and points of no meaning along a straight road, all of one segment."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (keyframes, 1, 1))
    T[:, 2, 3] = step_m * np.arange(keyframes)
    host, f = np.repeat(np.arange(keyframes, dtype=np.int32), 20), 20 * keyframes
    p_cam = np.column_stack([rng.uniform(-5, 5, f), rng.uniform(-2, 1.5, f), rng.uniform(3, 30, f)])
    uv = CAMERA.project(p_cam)
    features = PlaceFeatures(
        host, rng.integers(0, 256, (f, 32)).astype(np.uint8), np.abs(uv).astype(np.float32), p_cam.astype(np.float32),
        np.full(f, 0.25, np.float32),
    )  # fmt: skip
    cloud = PlaceCloud(
        host, np.rint(100 * p_cam).astype(np.int16), rng.choice(np.array([0, 2, 5, 8], np.uint8), f), np.full(f, 20, np.uint8)
    )
    camera = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.width, CAMERA.height)
    return Places(T, np.zeros(keyframes, np.int32), camera, features, cloud)
