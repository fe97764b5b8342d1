"""Vignetting of a drive's left camera, told by the ground that several of its views show.

A lens darkens what lies off its axis: I = (1 + r^2)^-p S, r the tangent of the angle from the axis; p = 2 is the law of cos^4. As
a camera drives on, a patch of ground moves towards the border of the image and nearer, and asphalt that is seen from near and
steeply is as bright as it likes. So the logarithms of what the views k of a stretch show of a patch i are explained by

    log I_ik = s_i - p log(1 + r_ik^2) + q log z_ik + g_k,

z the depth, g the view's exposure that the odometry has left; p, q and g by weights of Cauchy, the patch's own s_i taken out. The
fall-off p of the drive is the median of those of its stretches, weighted by what each knows of it, and 0 unless they agree on one.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.side_by_side import in_order
from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.ground.plane import GroundPlane, find_plane, first_to_match
from wayloom.ground.view import SURE_INSIDE, may_be_shown
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import grey_pair, one_opencv_thread
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.types import OdometryResult
from wayloom.places.road import road_m
from wayloom.places.stereo_pair import LeftLabels, right_rectifier

FloatArray = NDArray[np.float64]
Balance = tuple[FloatArray, FloatArray]
MOST_STRETCHES: Final = 24
VIEWS, VIEW_EVERY_M = 6, 1.6
"""Of a stretch: over its eight metres a patch comes from the middle of the image to its border."""
PATCH_M, FROM_M, TO_M, ASIDE_M = 0.5, 5.0, 17.0, 9.0
"""Patches of ground lie so far apart, before and beside the first camera of a stretch."""
PATCH_PX_SHARE: Final = 0.01
"""Of the image's width: over so many pixels a patch is averaged, so that its grain and a few centimetres of road do not count."""
LEAST_VIEWS, LEAST_PATCHES = 3, 60
DARKEST, BRIGHTEST = 6.0, 245.0
"""Grey levels outside are cut off by the sensor."""
SCALE: Final = 0.05
ROUNDS: Final = 10
LEAST_STRETCHES: Final = 5
SIGMAS: Final = 3.0
LARGEST: Final = 1.0
DECIMALS: Final = 2


def drive_fall_off(log: DriveLog, odometry: OdometryResult, labels: LeftLabels, balance: Balance, threads: int = 1) -> float:
    """The fall-off of the drive, 0 to LARGEST; 0 where its views do not tell one.

    balance : (K,) gain and offset that take each keyframe to the drive's exposure

    Raises StageError where an image's labels are missing, LogError where an image cannot be read.
    """
    return agreed(*stretch_fall_offs(log, odometry, labels, balance, threads))


def agreed(fall_offs: FloatArray, information: FloatArray) -> float:
    """Of the fall-offs (n,) of stretches and what each knows (n,): their median, 0 unless it is SIGMAS of its own sigma and there
    are enough stretches. 1.4826 and 1.2533 are those of the normal distribution, for deviations and for medians."""
    if len(fall_offs) < LEAST_STRETCHES:
        return 0.0
    middle = _median(fall_offs, information)
    scatter = 1.4826 * _median(np.abs(fall_offs - middle), information)
    sigma = 1.2533 * scatter * float(np.sqrt((information**2).sum()) / information.sum())
    return round(min(middle, LARGEST), DECIMALS) if middle > SIGMAS * sigma else 0.0


def _median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def stretch_fall_offs(
    log: DriveLog, odometry: OdometryResult, labels: LeftLabels, balance: Balance, threads: int = 1
) -> tuple[FloatArray, FloatArray]:
    """(n,) fall-offs of the stretches that tell one, and the information (n,) of each."""
    rectifier = right_rectifier(odometry)

    def told(rows: list[int]) -> tuple[float, float] | None:
        samples = _samples(log, odometry, labels, rows, balance, rectifier)
        return None if samples is None else fall_off_of(*samples)

    with one_opencv_thread():
        found = [one for one in in_order(told, stretches(odometry), threads) if one is not None]
    fall_offs, information = np.array(found, np.float64).reshape(-1, 2).T
    return fall_offs, information


def stretches(odometry: OdometryResult) -> list[list[int]]:
    """Keyframes, VIEWS a stretch and about VIEW_EVERY_M apart, of stretches that do not overlap and lie evenly over the drive."""
    road, segment = road_m(odometry.keyframes.T_world_cam), odometry.keyframes.segment
    all_of_them: list[list[int]] = [[]]
    for k, (at, number) in enumerate(zip(road.tolist(), segment.tolist(), strict=True)):
        open_one = all_of_them[-1]
        if open_one and segment[open_one[0]] != number:
            open_one.clear()
        if not open_one or at - road[open_one[-1]] >= VIEW_EVERY_M:
            open_one.append(k)
        if len(open_one) == VIEWS:
            all_of_them.append([])
    whole = all_of_them[:-1]
    taken = np.unique(np.linspace(0, len(whole) - 1, MOST_STRETCHES).round().astype(np.int64)) if whole else np.zeros(0, np.int64)
    return [whole[n] for n in taken.tolist()]


def _samples(
    log: DriveLog, odometry: OdometryResult, labels: LeftLabels, rows: list[int], balance: Balance, rectifier: RightRectifier
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Of a stretch's patches in its views (V, N): log brightness, NaN where one is not shown, log(1 + r^2) and log depth."""
    rig, camera = odometry.rig, odometry.rig.camera
    size = 2 * round(PATCH_PX_SHARE * camera.width / 2.0) + 1
    patches, parts = None, []
    for row in rows:
        pair, T_world_cam = grey_pair(log, int(odometry.keyframes.frame[row])), odometry.keyframes.T_world_cam[row]
        left, shown = pair.left, may_be_shown(labels.left(row), 0.0) >= SURE_INSIDE
        if patches is None:
            first = first_to_match(shown)
            plane = find_plane(left[first:], rectifier.align(pair.right, first), shown[first:], first, rig)
            if plane is None:
                return None
            patches = se3.transform(T_world_cam, on_plane(plane, rig, odometry.disparity_bias_px))
        p_cam = se3.transform(se3.inverse(T_world_cam), patches)
        uv = camera.project(p_cam)
        inside = camera.contains(uv, size / 2.0)
        u, v = np.rint(np.where(inside[:, None], uv, 0.0)).astype(np.int64).T
        level = cv2.blur(left, (size, size))[v, u].astype(np.float64)
        told = inside & shown[v, u] & (level > DARKEST) & (level < BRIGHTEST)
        value = balance[0][row] * level + balance[1][row]
        z = np.maximum(p_cam[:, 2], 0.1)
        r2 = (p_cam[:, 0] ** 2 + p_cam[:, 1] ** 2) / z**2
        parts.append((np.where(told & (value > 1.0), np.log(np.maximum(value, 1.0)), np.nan), np.log1p(r2), np.log(z)))
    level, fall, depth = map(np.array, zip(*parts, strict=True))
    return level, fall, depth


def on_plane(plane: GroundPlane, rig: StereoRig, bias_px: float) -> FloatArray:
    """(N, 3) patches of ground before a camera, in its frame: a grid over X and Z, Y by the plane of disparities,
    bf / Z + bias = a (fx X / Z + cx) + b (fy Y / Z + cy) + c."""
    camera, a, b = rig.camera, plane.slope_u, plane.slope_v
    x, z = (one.ravel() for one in np.meshgrid(np.arange(-ASIDE_M, ASIDE_M + PATCH_M, PATCH_M), np.arange(FROM_M, TO_M, PATCH_M)))
    at_centre = a * camera.cx + b * camera.cy + plane.offset - bias_px
    y = (rig.bf - a * camera.fx * x - at_centre * z) / (b * camera.fy)
    return np.column_stack([x, y, z])


def fall_off_of(level: FloatArray, fall: FloatArray, depth: FloatArray) -> tuple[float, float] | None:
    """The fall-off that the patches (V, N) of a stretch tell and its information; None where LEAST_VIEWS see too few of them."""
    seen = np.isfinite(level) & (np.isfinite(level).sum(axis=0) >= LEAST_VIEWS)
    if seen.any(axis=0).sum() < LEAST_PATCHES:
        return None
    count = np.maximum(seen.sum(axis=0), 1)

    def about_patch(values: FloatArray) -> FloatArray:
        """(M,) of the patches' own means."""
        values = np.where(seen, values, 0.0)
        return np.asarray((values - values.sum(axis=0) / count)[seen])

    views = [np.broadcast_to((np.arange(len(level)) == k)[:, None], level.shape) for k in range(1, len(level))]
    A = np.column_stack([about_patch(-fall), *(about_patch(1.0 * one) for one in (depth, *views))])
    y, weight = about_patch(level), np.ones(int(seen.sum()))
    for _ in range(ROUNDS):
        W = A * weight[:, None]
        covariance = np.linalg.pinv(W.T @ A, hermitian=True)  # a view that shows no patch has no exposure
        x = covariance @ (W.T @ y)
        weight = 1.0 / (1.0 + ((y - A @ x) / SCALE) ** 2)
    return (float(x[0]), 1.0 / float(covariance[0, 0])) if covariance[0, 0] > 0.0 else None
