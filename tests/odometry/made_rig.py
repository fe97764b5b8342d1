"""Drives through the made street whose right camera has a lens that the calibration does not know."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from odometry.made_street import KEPT, PLANES, TEXELS_PER_M, TEXTURES, MadeLog, bilinear, grey, render
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import IDENTITY, RightLens, at_infinity
from wayloom.logs.types import StereoFrame

CAMERA = PinholeCamera(300.0, 300.0, 239.5, 89.5, 480, 180)
RIG = StereoRig(CAMERA, (-0.54, 0.0, 0.0))
LENS = RightLens(1e-3, -2e-3, 1.5e-3, 2e-3, -3e-3, 1.002, -0.6, 0.006, -1e-3, 1.5e-3)


def right_image(T_world_cam: np.ndarray, rig: StereoRig, lens: RightLens) -> np.ndarray:
    """(h, w) grey levels that the real right camera sees: its pixels look where the lens's inverse says, from its own place."""
    camera = rig.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    ideal = at_infinity(lens).ideal_pixels(camera, 0.0, np.column_stack([u.ravel(), v.ravel()]))
    rays = camera.rays(ideal) @ T_world_cam[:3, :3].T
    shift = np.array(rig.t_right_left) + rig.baseline_m * np.array([0.0, lens.ty, lens.tz])
    origin = T_world_cam[:3, 3] - T_world_cam[:3, :3] @ shift
    best, image = np.zeros(len(rays)), np.zeros(len(rays))
    for (normal, distance), plane in zip(PLANES, TEXTURES, strict=True):
        n = np.array(normal)
        rho = rays @ n / (distance - origin @ n)
        nearer = rho > best
        points = origin + rays[nearer] / rho[nearer, None]
        st = (points[:, [axis for axis in range(3) if n[axis] == 0.0]] * TEXELS_PER_M) % 1024
        image[nearer], best[nearer] = bilinear(plane, st[:, 0], st[:, 1]), rho[nearer]
    return image.reshape(u.shape)


@lru_cache(KEPT)
def grey_pair(pose: bytes, rig: StereoRig, lens: RightLens) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Left and right image of a pose (4, 4) as bytes."""
    T = np.frombuffer(pose).reshape(4, 4)
    return grey(render(T, rig.camera)[0]), grey(right_image(T, rig, lens))


@dataclass
class LensLog(MadeLog):
    """A drive of the made street with a lens in front of the right camera."""

    rig: StereoRig = RIG
    lens: RightLens = IDENTITY

    def frame(self, index: int) -> StereoFrame:
        left, right = (image.copy() for image in grey_pair(self.truth[index].tobytes(), self.rig, self.lens))
        return StereoFrame(index, int(self.t_ns[index]), left, right)
