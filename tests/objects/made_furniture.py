"""A made street with exact things beside it: a front, a stripe painted on it, a pole, a sign on its post, a trunk."""

from dataclasses import dataclass

import numpy as np

from made_ground import CAMERA, RIG, MadeStreet, grey_at
from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3

POLE_AT, SIGN_AT, TRUNK_AT = np.array([4.0, 12.0, 0.12]), np.array([3.6, 17.0, 2.4]), np.array([-3.5, 13.0, 0.0])
POLE_M, TRUNK_M, SIGN_M = 0.12, 0.3, 0.7
FRONT_X_M, STRIPE_Y_M = 6.5, 15.0


@dataclass
class FurnishedStreet(MadeStreet):
    """The street with its things; labels are exact.

    from_behind : whether the drive sees the sign's dull back, and its bright post before it
    pole_tall_m : height of the pole
    """

    from_behind: bool = False
    pole_tall_m: float = 3.2

    def images(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """left, right, label."""
        T = self.T_enu_cam[index]
        left, label = self._furnished(T)
        right, _ = self._furnished(T @ se3.from_rotation_translation(np.eye(3), -np.array(RIG.t_right_left)))
        return np.rint(left).astype(np.uint8), np.rint(right).astype(np.uint8), label

    def _furnished(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        image, label = self._drawn(T)
        v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
        rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()])) @ T[:3, :3].T
        c, flat, flat_label = T[:3, 3], image.ravel().copy(), label.ravel().copy()
        nearest = np.full(len(rays), np.inf)

        def draw(z: np.ndarray, on: np.ndarray, grey: np.ndarray, class_name: str) -> None:
            hit = on & (z > 0.5) & (z < nearest) & (c[2] + z * rays[:, 2] > 0.0)
            nearest[hit], flat[hit], flat_label[hit] = z[hit], grey[hit], CLASS_ID[class_name]

        with np.errstate(divide="ignore", invalid="ignore"):
            z = (FRONT_X_M - c[0]) / rays[:, 0]
            y, rise = c[1] + z * rays[:, 1], c[2] + z * rays[:, 2]
            front = grey_at(y.reshape(label.shape) % 40.0 - 20.0, rise.reshape(label.shape)).ravel()
            draw(z, (rise < 9.0) & (z < 80.0), front, "building")
            stripe = np.abs(y - STRIPE_Y_M) < 0.12
            draw(z - 1e-9, stripe & (rise < 3.5), 0.4 * front, "pole")
            z = (SIGN_AT[1] - c[1]) / rays[:, 1]
            x, rise = c[0] + z * rays[:, 0], c[2] + z * rays[:, 2]
            checks = 130.0 + 90.0 * np.sin(23.0 * x + 3.0 * np.sin(19.0 * rise)) * np.cos(17.0 * rise)
            plate = 60.0 + 0.15 * checks if self.from_behind else checks
            draw(z, (np.abs(x - SIGN_AT[0]) < SIGN_M / 2) & (np.abs(rise - SIGN_AT[2]) < SIGN_M / 2), plate, "traffic sign")
            away = np.array([0.0, -0.05 if self.from_behind else 0.05, 0.0])
            posts = [
                (SIGN_AT + away, 0.08, 2.05, "pole"),
                (SIGN_AT + away, 0.08, 2.7, "traffic sign" if self.from_behind else "pole"),
            ]
            for at, wide, tall, name in (
                (POLE_AT, POLE_M, self.pole_tall_m, "pole"),
                *posts,
                (TRUNK_AT, TRUNK_M, 2.6, "vegetation"),
            ):
                z = ((at - c)[:2] @ rays[:, :2].T) / (rays[:, :2] ** 2).sum(axis=1)
                aside = np.hypot(*(c[:2] + z[:, None] * rays[:, :2] - at[:2]).T)
                rise = c[2] + z * rays[:, 2]
                bright = 180.0 if self.from_behind and name != "vegetation" else 45.0
                draw(z, (aside < wide / 2) & (rise < tall), bright + 25.0 * np.sin(17.0 * rise), name)
        return flat.reshape(label.shape), flat_label.reshape(label.shape)
