"""A made street with exact ground: a textured road with a raised sidewalk, drawn by ray casting for a stereo pair, with labels."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.ground.exposure import unfallen
from wayloom.logs.types import StereoFrame
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory
from wayloom.submaps.submap import PlacedSubmap, Submap

CAMERA = PinholeCamera(280.0, 280.0, 175.5, 60.0, 352, 150)
RIG = StereoRig(CAMERA, (-0.6, 0.0, 0.0))
HEIGHT_M, KERB_M, KERB_AT_M = 1.5, 0.12, 3.0
PERSON_GREY = 255
WALKER_GREY = 232.0
TEXEL_M = 0.03


def texture(seed: int = 5) -> np.ndarray:
    """(1600, 1600) float32 grey of the ground, 40 to 200: noise at several scales, TEXEL_M a texel."""
    rng = np.random.default_rng(seed)
    out = np.zeros((1600, 1600), np.float32)
    for sigma, weight in ((1.5, 1.0), (4.0, 1.0), (12.0, 1.0)):
        layer = cv2.GaussianBlur(rng.standard_normal(out.shape).astype(np.float32), (0, 0), sigma)
        out += weight * layer / layer.std()
    return np.clip(120.0 + 25.0 * out, 40.0, 200.0)


TEXTURE = texture()


def grey_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey of the ground at east x and north y."""
    u, v = (x + 24.0) / TEXEL_M, (y + 8.0) / TEXEL_M
    return cv2.remap(TEXTURE, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)


def pose(y: float) -> np.ndarray:
    """T_enu_cam of a camera HEIGHT_M over the road that looks north and a little down."""
    down = 0.06
    R = np.array([[1.0, 0.0, 0.0], [0.0, -np.sin(down), np.cos(down)], [0.0, -np.cos(down), -np.sin(down)]])
    return se3.from_rotation_translation(R, np.array([0.0, y, HEIGHT_M]))


@dataclass(frozen=True)
class Walker:
    """A light person, 1.7 m tall, who crosses the street at north `y_m`, from east `x_m` on, by step_m a frame.

    In the frames of `missed` the labels show what is behind, in those of `legless` the person's lower half is labelled so.
    """

    y_m: float
    x_m: float
    step_m: float
    missed: tuple[int, ...] = ()
    legless: tuple[int, ...] = ()


@dataclass
class MadeStreet:
    """A log of `count` frames; `person` (frame, u0, v0, u1, v1) draws a white person there, in the left image.

    fall_off : brightness falls as (1 + r^2)^-fall_off towards the border of the images
    """

    count: int = 12
    step_m: float = 0.8
    gains: Any = None
    person: Any = None
    walker: Walker | None = None
    fall_off: float = 0.0

    def __post_init__(self) -> None:
        self.rig, self.t_ns = RIG, np.arange(self.count, dtype=np.int64) * 100_000_000
        self.T_enu_cam = np.array([pose(self.step_m * k) for k in range(self.count)])
        self.reads = 0

    def __len__(self) -> int:
        return self.count

    def walker_at(self, index: int, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) grey of the walker, NaN elsewhere, and height in m, as the camera at T sees them in a frame."""
        walker, shape = self.walker, (CAMERA.height, CAMERA.width)
        if walker is None:
            return np.full(shape, np.nan), np.full(shape, np.nan)
        v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
        rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()])) @ T[:3, :3].T
        z = (walker.y_m - T[1, 3]) / rays[:, 1]
        across = T[0, 3] + z * rays[:, 0] - (walker.x_m + walker.step_m * index)
        rise = T[2, 3] + z * rays[:, 2]
        on = (z > 0.5) & (np.abs(across) < 0.25) & (rise > 0.0) & (rise < 1.7)
        grey = WALKER_GREY + 20.0 * np.sin(23.0 * rise + 5.0 * np.sin(17.0 * across)) * np.cos(19.0 * across)
        return np.where(on, grey, np.nan).reshape(shape), np.where(on, rise, np.nan).reshape(shape)

    def _drawn(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
        rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()])) @ T[:3, :3].T
        c = T[:3, 3]
        image, label = np.full(len(rays), 230.0), np.full(len(rays), CLASS_ID["sky"], np.uint8)
        depth = np.full(len(rays), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for height, class_id in ((0.0, "road"), (KERB_M, "sidewalk")):
                z = (height - c[2]) / rays[:, 2]
                x = c[0] + z * rays[:, 0]
                hit = (z > 0.0) & (z < 60.0) & ((x > KERB_AT_M) == (height > 0.0)) & (z < depth)
                image[hit] = grey_at(x[hit], c[1] + z[hit] * rays[hit, 1]).ravel()
                label[hit], depth[hit] = CLASS_ID[class_id], z[hit]
            z = (KERB_AT_M - c[0]) / rays[:, 0]
            rise = c[2] + z * rays[:, 2]
            face = (z > 0.0) & (rise >= 0.0) & (rise <= KERB_M) & (z < depth)
        image[face], label[face] = 90.0, CLASS_ID["sidewalk"]
        shape = (CAMERA.height, CAMERA.width)
        return image.reshape(shape), label.reshape(shape)

    def images(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """left, right, label."""
        T = self.T_enu_cam[index]
        left, label = self._drawn(T)
        T_right = T @ se3.from_rotation_translation(np.eye(3), -np.array(RIG.t_right_left))
        right, _ = self._drawn(T_right)
        (left_walker, rise), (right_walker, _) = self.walker_at(index, T), self.walker_at(index, T_right)
        left = np.where(np.isnan(left_walker), left, left_walker)
        right = np.where(np.isnan(right_walker), right, right_walker)
        gain = (1.0 if self.gains is None else self.gains[index]) / unfallen(CAMERA, self.fall_off)
        pair = [np.rint(np.clip(gain * image, 0, 255)).astype(np.uint8) for image in (left, right)]
        if self.walker is not None and index not in self.walker.missed:
            label[rise > (0.8 if index in self.walker.legless else 0.0)] = CLASS_ID["person"]
        if self.person is not None and index == self.person[0]:
            _, u0, v0, u1, v1 = self.person
            pair[0][v0:v1, u0:u1], label[v0:v1, u0:u1] = PERSON_GREY, CLASS_ID["person"]
        return pair[0], pair[1], label

    def frame(self, index: int) -> StereoFrame:
        self.reads += 1
        left, right, _ = self.images(index)
        return StereoFrame(index, int(self.t_ns[index]), left, right)

    def left(self, keyframe: int) -> np.ndarray:
        """Labels of a keyframe's left image."""
        return self.images(keyframe)[2]

    def odometry(self) -> OdometryResult:
        """The exact result: every frame a keyframe."""
        T = se3.inverse(self.T_enu_cam[0]) @ self.T_enu_cam
        n, segment = self.count, np.zeros(self.count, np.int32)
        a = np.zeros(n) if self.gains is None else np.log(self.gains)
        affine = np.column_stack([a, np.zeros(n), a, np.zeros(n)])
        points = Points(
            np.zeros(0, np.int32), np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros(0, np.float32),
            np.zeros(0, np.uint8), np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros(0, bool), np.zeros(0, bool),
        )  # fmt: skip
        keyframes = Keyframes(np.arange(n, dtype=np.int32), T, affine, segment)
        return OdometryResult(RIG, Trajectory(self.t_ns, T, np.ones(n, bool), segment), keyframes, points, 0.0, np.zeros(3))

    def submaps(self, pieces: int = 1) -> list[PlacedSubmap]:
        """The street cut into pieces, each at its place."""
        out = []
        for rows in np.array_split(np.arange(self.count), pieces):
            anchor = self.T_enu_cam[rows[len(rows) // 2]]
            empty = {name: np.zeros(0, kind) for name, kind in SUBMAP_ARRAYS.items()}
            submap = Submap(
                xyz=np.zeros((0, 3), np.float32), **empty, vote_start=np.zeros(1, np.uint32), keyframe_frame=rows.astype(np.uint32),
                keyframe_t_ns=self.t_ns[rows], T_submap_cam=se3.inverse(anchor) @ self.T_enu_cam[rows], length_m=10.0,
                points_left_out={},
            )  # fmt: skip
            out.append(PlacedSubmap(submap, anchor, np.full((6, 6), np.nan), "drive", None))
        return out


class BuiltUpStreet(MadeStreet):
    """The street with its sidewalk called building."""

    def left(self, keyframe: int) -> np.ndarray:
        label = super().left(keyframe)
        return np.where(label == CLASS_ID["sidewalk"], CLASS_ID["building"], label).astype(np.uint8)


SUBMAP_ARRAYS = {
    "label": np.uint8, "variance": np.float32, "grey": np.uint8, "seen_ns": np.int64, "keyframe": np.uint32,
    "vote_class": np.uint8, "vote_weight": np.float32,
}  # fmt: skip
