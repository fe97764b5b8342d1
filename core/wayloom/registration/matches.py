"""Matches of local features between two views, and poses from them: for places that are seen again in the same direction."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.places.types import PlaceView
from wayloom.registration.search import level_pose

FloatArray = NDArray[np.float64]
KEYFRAMES: Final = 6
"""Keyframes of each view whose features are matched, those nearest to the anchor."""
RATIO: Final = 0.85
MOST_BITS: Final = 72
"""Bits in which two descriptors may differ."""
SIGMA_PX: Final = 1.0
LOOSE: Final = 4.0
"""Times sigma while two level frames may still tilt against each other."""
ROUNDS: Final = 256
JUDGES: Final = 160
"""Matches that judge each round, evenly chosen."""
GATE2: Final = 9.21
"""Chi-square, 2 degrees of freedom, 99 %."""


@dataclass(frozen=True, slots=True)
class Matches:
    """M matched features, one side.

    p_level      (M, 3) m, the view's level frame
    spread       (M, 3, 3) m^2 covariance along the ray, level frame
    seen_at      (M, 2) x / z and y / z in the feature's camera
    T_cam_level  (M, 4, 4) to that camera
    focal_px     of that camera
    """

    p_level: FloatArray
    spread: FloatArray
    seen_at: FloatArray
    T_cam_level: FloatArray
    focal_px: float

    def __len__(self) -> int:
        return len(self.p_level)

    def depth_sigma(self) -> FloatArray:
        """(M, 3) m, level frame: along each ray, one standard deviation long."""
        ray = self.p_level - se3.inverse(self.T_cam_level)[:, :3, 3]
        sigma = np.sqrt(np.trace(self.spread, axis1=1, axis2=2))
        return np.asarray(ray * (sigma / np.maximum(np.linalg.norm(ray, axis=1), 1e-9))[:, None])

    def every(self, step: int) -> "Matches":
        """One of `step` matches."""
        return self.take(slice(None, None, step))

    def take(self, rows: slice | NDArray[np.bool_]) -> "Matches":
        """Some of the matches; a mask has (M,) rows."""
        return Matches(self.p_level[rows], self.spread[rows], self.seen_at[rows], self.T_cam_level[rows], self.focal_px)


def match(a: PlaceView, b: PlaceView) -> tuple[Matches, Matches]:
    """Mutual nearest descriptors that pass the ratio test, keyframe by keyframe."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    pairs = []
    for rows_a in _nearest_keyframes(a):
        for rows_b in _nearest_keyframes(b):
            bits_a, bits_b = a.features.bits[rows_a], b.features.bits[rows_b]
            if len(rows_a) < 2 or len(rows_b) < 2:
                continue
            back = {m[0].queryIdx: m[0].trainIdx for m in matcher.knnMatch(bits_b, bits_a, k=1)}
            for first, second in matcher.knnMatch(bits_a, bits_b, k=2):
                good = first.distance <= min(MOST_BITS, RATIO * second.distance)
                if good and back[first.trainIdx] == first.queryIdx:
                    pairs.append((rows_a[first.queryIdx], rows_b[first.trainIdx]))
    rows = np.array(sorted(set(pairs)), np.int64).reshape(-1, 2)
    return _side(a, rows[:, 0]), _side(b, rows[:, 1])


def _nearest_keyframes(view: PlaceView) -> list[NDArray[np.int64]]:
    """Rows of the features of each of the keyframes nearest to the anchor."""
    near = np.argsort(np.linalg.norm(view.T_level_keyframe[:, :3, 3], axis=1), kind="stable")[:KEYFRAMES]
    return [np.flatnonzero(view.features.keyframe == k) for k in np.sort(near)]


def _side(view: PlaceView, rows: NDArray[np.int64]) -> Matches:
    features = view.features
    p_cam = features.p_cam[rows].astype(np.float64)
    T = view.T_level_keyframe[features.keyframe[rows]].reshape(-1, 4, 4)
    along = (T[:, :3, :3] @ (p_cam / np.maximum(np.linalg.norm(p_cam, axis=1), 1e-9)[:, None])[..., None])[..., 0]
    spread = np.einsum("ni,nj->nij", along, along) * (features.sigma_m[rows].astype(np.float64) ** 2)[:, None, None]
    p_level = (T[:, :3, :3] @ p_cam[..., None])[..., 0] + T[:, :3, 3]
    return Matches(p_level, spread, p_cam[:, :2] / p_cam[:, 2:], se3.inverse(T), _focal_px(view))


def _focal_px(view: PlaceView) -> float:
    """Of the view's camera, from where its features stand in image and space."""
    p = view.features.p_cam.astype(np.float64)
    x = p[:, 0] / p[:, 2] if len(p) else np.zeros(0)
    if len(x) < 2 or np.ptp(x) < 1e-6:
        return 1.0
    return float(np.polyfit(x, view.features.uv[:, 0].astype(np.float64), 1)[0])


def pose_of_matches(a: Matches, b: Matches) -> tuple[FloatArray, int] | None:
    """T_a_b (4, 4) that most matches agree with, and how many; None where there are too few.

    Two matches give heading and shift of one level frame in the other (RANSAC with fixed draws); the whole pose follows from
    all that agree, in pixels both ways.
    """
    if len(a) < 4:
        return None
    draws = np.random.default_rng(0).integers(0, len(a), (ROUNDS, 2))
    best, least = np.eye(4), np.inf
    step = -(-len(a) // JUDGES)
    some_a, some_b = a.every(step), b.every(step)
    for i, j in draws[draws[:, 0] != draws[:, 1]]:
        T = _two_point_pose(a.p_level[[i, j]], b.p_level[[i, j]])
        if T is not None:
            loss = float(np.minimum(errors2(T, some_a, some_b, LOOSE * SIGMA_PX), GATE2).sum())
            if loss < least:
                best, least = T, loss
    for sigma_px in (LOOSE * SIGMA_PX, LOOSE * SIGMA_PX, 2.0 * SIGMA_PX, SIGMA_PX, SIGMA_PX):
        for _ in range(3):
            H, g = equations(best, a, b, sigma_px)
            best = se3.exp(np.asarray(np.linalg.solve(H + 1e-3 * np.eye(6), g))) @ best
    return best, int((errors2(best, a, b, SIGMA_PX) < GATE2).sum())


def _two_point_pose(p_a: FloatArray, p_b: FloatArray) -> FloatArray | None:
    """Level pose (4, 4) that lays two points (2, 3) on two others; None where they are too near or not equally far apart."""
    d_a, d_b = p_a[1] - p_a[0], p_b[1] - p_b[0]
    length_a, length_b = np.hypot(d_a[0], d_a[1]), np.hypot(d_b[0], d_b[1])
    if min(length_a, length_b) < 2.0 or max(length_a, length_b) > 1.3 * min(length_a, length_b):
        return None
    yaw = float(np.arctan2(d_a[1], d_a[0]) - np.arctan2(d_b[1], d_b[0]))
    T = level_pose(0.0, 0.0, 0.0, yaw)
    T[:3, 3] = (p_a - se3.transform(T, p_b)).mean(axis=0)
    return T


def errors2(T_a_b: FloatArray, a: Matches, b: Matches, sigma_px: float) -> FloatArray:
    """(M,) chi-square (2 degrees of freedom) of each match: the mean of both ways, each point in the other's image."""
    one, _ = _way(T_a_b, a, b, sigma_px)
    other, _ = _way(se3.inverse(T_a_b), b, a, sigma_px)
    return 0.5 * (_norm2(*one) + _norm2(*other))


def equations(T_a_b: FloatArray, a: Matches, b: Matches, sigma_px: float) -> tuple[FloatArray, FloatArray]:
    """H (6, 6) and g (6,) of the left perturbation of T_a_b, H xi = g, with Geman-McClure weights."""
    T_b_a = se3.inverse(T_a_b)
    (r_a, W_a), J_a = _way(T_a_b, a, b, sigma_px)
    # T_b_a' = T_b_a exp(-xi) = exp(-Ad(T_b_a) xi) T_b_a
    (r_b, W_b), J_b = _way(T_b_a, b, a, sigma_px)
    J_b = -J_b @ se3.adjoint(T_b_a)
    weight = 0.5 / (1.0 + 0.5 * (_norm2(r_a, W_a) + _norm2(r_b, W_b)) / GATE2) ** 2
    H, g = np.zeros((6, 6)), np.zeros(6)
    for r, W, J in ((r_a, W_a, J_a), (r_b, W_b, J_b)):
        JW = np.einsum("nki,nkl->nil", J, W) * weight[:, None, None]
        H += np.einsum("nil,nlj->ij", JW, J)
        g -= np.einsum("nil,nl->i", JW, r)
    return H, g


def _way(T_a_b: FloatArray, a: Matches, b: Matches, sigma_px: float) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """b's points in a's images: residuals (M, 2) in x / z and y / z, their information (M, 2, 2), and Jacobian (M, 2, 6)."""
    p_a = se3.transform(T_a_b, b.p_level)
    R_cam = a.T_cam_level[:, :3, :3]
    q = (R_cam @ p_a[..., None])[..., 0] + a.T_cam_level[:, :3, 3]
    z = q[:, 2]
    behind = z < 0.5
    z = np.where(behind, 0.5, z)
    projection = np.zeros((len(q), 2, 3))
    projection[:, 0, 0] = projection[:, 1, 1] = 1.0 / z
    projection[:, :, 2] = -q[:, :2] / (z**2)[:, None]
    residual = q[:, :2] / z[:, None] - a.seen_at
    residual[behind] = 1e3 / a.focal_px * sigma_px
    A = projection @ R_cam
    spread = A @ (T_a_b[:3, :3] @ b.spread @ T_a_b[:3, :3].T) @ np.swapaxes(A, 1, 2)
    information = np.asarray(np.linalg.inv(spread + (sigma_px / a.focal_px) ** 2 * np.eye(2)), np.float64)
    J = np.concatenate([A, -A @ se3.hat(p_a)], axis=2)
    J[behind] = 0.0
    return (residual, information), J


def _norm2(r: FloatArray, W: FloatArray) -> FloatArray:
    out: FloatArray = np.einsum("ni,nij,nj->n", r, W, r)
    return out
