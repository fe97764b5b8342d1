"""Up by what stands upright: planes of facades, whose normals are level, and poles.

In a frame that is level up to a small lean the true up is (dx, dy, 1). A facade's plane with the level normal n and the slope t,
n.p = c + t z, says n.(dx, dy) = t; walls on both sides of a street say the same, so cross fall is nothing to them, and neither is a
constant error of disparity: it moves a point along its ray by a share that is the same all along an upright line at one depth. One
that grows with the image row tilts walls that are seen from the front by its whole, those beside the street by less and to opposite
sides: along the view uprights say little. A pole along (bx, by, 1) says (dx, dy) = (bx, by).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wayloom.config.classes import CLASS_ID
from wayloom.georeference.gravity.sections import Section

FloatArray = NDArray[np.float64]
FACADES = [CLASS_ID[name] for name in ("building", "wall", "fence")]
POLES = [CLASS_ID[name] for name in ("pole", "traffic light", "traffic sign")]
ROUNDS, PLANES, MIN_POINTS, INLIER_M, LAYER_M = 200, 8, 25, 0.3, 1.0
MIN_SPAN_M, MAX_SPAN_M = 1.0, 12.0
FACADE_SIGMA, POLE_SIGMA, FRONTAL_SIGMA, WIDE_RAD = np.radians(1.0), np.radians(2.0), np.radians(4.0), 0.5
"""How upright walls and poles are, each for itself: bays, ledges, columns that lean; what errs along the view; what up is known to
before."""
POLE_REACH_M, POLE_POINTS, POLE_HEIGHT_M = 0.4, 6, 1.5
MIN_HEIGHT_SPREAD_M = 0.7
UPRIGHTENINGS = 4
LEAST_FREE, LEAST_RATIO = 6, 1.5
"""Degrees of freedom from which a drive's own uprights tell how much they scatter; and the least ratio of sigmas: what one section
sees shares its depths' errors, so that its planes are fewer witnesses than they are planes."""
ITERATIONS, CAUCHY, LEAST_SCALE_M = 10, 2.385, 0.01


@dataclass(frozen=True, slots=True)
class Lean:
    """By how much up leans in a section's frame: (2,) rad to the right and ahead, covariance (2, 2), and by how many sigma each
    witness (n,) within the section differs from it."""

    right_ahead: FloatArray
    covariance: FloatArray
    differs: FloatArray


def lean_by_uprights(section: Section) -> Lean | None:
    """None where nothing stands upright. Same input, same answer.

    Points are taken into a plane by their distance to an upright one, which holds the slope near nothing where up leans; so it is
    done again in the frame that has been set upright.
    """
    found: Lean | None = None
    for _ in range(UPRIGHTENINGS):
        so_far = np.zeros(2) if found is None else found.right_ahead
        points = section.points_level - section.points_level[:, 2:] * [*so_far, 0.0]
        lean = _lean(points, section.label, section.T_level_cam[:2, 2])
        if lean is None:
            return None
        found = replace(lean, right_ahead=so_far + lean.right_ahead)
    return found


def scatter_ratio(leans: list[Lean]) -> float:
    """By how many times a drive's uprights differ more than their sigmas say, by the median, and never less than LEAST_RATIO.

    Every section has learnt two numbers from its own, so of n witnesses n - 2 are left.
    """
    differs = np.concatenate([lean.differs for lean in leans]) if leans else np.zeros(0)
    free = len(differs) - 2 * len(leans)
    if free < LEAST_FREE:
        return LEAST_RATIO
    return max(LEAST_RATIO, 1.4826 * float(np.median(np.abs(differs))) * float(np.sqrt(len(differs) / free)))


def _lean(points: FloatArray, label: NDArray[np.uint8], ahead: FloatArray) -> Lean | None:
    """By points (n, 3); ahead (2,) is the camera's view on the ground plan."""
    rows = [*_facades(points[np.isin(label, FACADES)]), *_poles(points[np.isin(label, POLES)])]
    if not rows:
        return None
    A = np.array([row[:2] for row in rows])
    t, sigma = np.array([row[2:] for row in rows]).T
    sigma = np.hypot(sigma, FRONTAL_SIGMA * (A @ ahead))
    weight = 1.0 / sigma**2
    for _ in range(ITERATIONS):
        information = (A * weight[:, None]).T @ A + np.eye(2) / WIDE_RAD**2
        lean = np.linalg.solve(information, A.T @ (weight * t))
        weight = 1.0 / (sigma**2 + ((t - A @ lean) / CAUCHY) ** 2)
    return Lean(lean, np.linalg.inv(information), (t - A @ lean) / sigma)


def _facades(left: FloatArray) -> list[list[float]]:
    """[nx, ny, n.lean, sigma] of each plane among points (n, 3), the fullest first (RANSAC on the plan, then least squares)."""
    rng, found = np.random.default_rng(0), []
    for _ in range(PLANES):
        if len(left) < MIN_POINTS:
            break
        distance = _fullest_line(left[:, :2], rng)
        inlier = distance < INLIER_M
        if inlier.sum() < MIN_POINTS:
            break
        row = _slope(left[inlier])
        if row is not None:
            found.append(row)
        left = left[distance > LAYER_M]  # a thick facade is no two witnesses
    return found


def _fullest_line(xy: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) m: distances from the line through two of the points that has most of them within INLIER_M."""
    a, b = xy[rng.integers(len(xy), size=(2, ROUNDS))]
    along = b - a
    span = np.linalg.norm(along, axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(span, 1e-9)[:, None]
    distance = np.abs(xy @ normal.T - (a * normal).sum(axis=1))
    count = np.where((span > MIN_SPAN_M) & (span < MAX_SPAN_M), (distance < INLIER_M).sum(axis=0), 0)
    return np.asarray(distance[:, int(np.argmax(count))] if count.max() else np.full(len(xy), np.inf))


def _slope(points: FloatArray) -> list[float] | None:
    """[nx, ny, n.lean, sigma] of the plane of points (n, 3), re-weighted; None where it spans too little height."""
    centre = points.mean(axis=0)
    p = points - centre
    if p[:, 2].std() < MIN_HEIGHT_SPREAD_M:
        return None
    normal = np.linalg.eigh(p[:, :2].T @ p[:, :2])[1][:, 0]
    tangent = np.array([-normal[1], normal[0]])
    A = np.column_stack([p[:, :2] @ tangent, p[:, 2], np.ones(len(p))])
    x, covariance = fitted(A, p[:, :2] @ normal)
    sigma = float(np.hypot(np.sqrt(covariance[1, 1]), FACADE_SIGMA))
    turned = normal - x[0] * tangent
    turned /= np.linalg.norm(turned)
    return [*turned.tolist(), float(x[1]), sigma]


def fitted(A: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x (k,) of A x = b, A (n, k), by Cauchy's weights, and its covariance by the residuals' own scatter."""
    weight = np.ones(len(b))
    for _ in range(ITERATIONS):
        information = (A * weight[:, None]).T @ A
        x = np.asarray(np.linalg.solve(information, A.T @ (weight * b)), np.float64)
        residual = b - A @ x
        scale = max(1.4826 * float(np.median(np.abs(residual))), LEAST_SCALE_M)
        weight = 1.0 / (1.0 + (residual / (CAUCHY * scale)) ** 2)
    return x, np.asarray(scale**2 * np.linalg.inv(information))


def _poles(points: FloatArray) -> list[list[float]]:
    """[1, 0, lean, sigma] and [0, 1, lean, sigma] of each cluster of points (n, 3) that is upright and high enough."""
    found: list[list[float]] = []
    if len(points) < POLE_POINTS:
        return found
    pairs = cKDTree(points[:, :2]).query_pairs(POLE_REACH_M, output_type="ndarray")
    joined = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    cluster = connected_components(joined, directed=False)[1]
    order = np.argsort(cluster, kind="stable")
    count = np.bincount(cluster)
    start, z = np.cumsum(count) - count, points[order, 2]
    high = np.maximum.reduceat(z, start) - np.minimum.reduceat(z, start) >= POLE_HEIGHT_M
    upright = (count >= POLE_POINTS) & high
    if not upright.any():
        return found
    lean, sigma = _lines(points[order[np.repeat(upright, count)]], count[upright])
    sigma = np.hypot(sigma, POLE_SIGMA)
    for pole in range(len(lean)):
        found += [[1.0 - axis, float(axis), float(lean[pole, axis]), float(sigma[pole, axis])] for axis in range(2)]
    return found


def _lines(points: FloatArray, count: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Lines through groups of points, `count` (L,) of (n, 3) each, one group behind the other: by how much x and y grow with z
    (L, 2), and the sigmas of that. As `fitted` for each group and axis, all of them at once."""
    start, group = np.cumsum(count) - count, np.repeat(np.arange(len(count)), count)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, start, axis=0))[group]

    centred = points - total(points) / count[group, None]
    z, xy, weight = centred[:, 2:], centred[:, :2], np.ones((len(points), 2))
    middle = start + (count - 1) // 2, start + count // 2
    for _ in range(ITERATIONS):
        w, wz, wzz = total(weight), total(weight * z), total(weight * z * z)
        wb, wzb, determinant = total(weight * xy), total(weight * z * xy), w * wzz - wz**2
        slope, offset = (w * wzb - wz * wb) / determinant, (wzz * wb - wz * wzb) / determinant
        residual = xy - slope * z - offset
        size = np.abs(residual)
        ranked = np.column_stack([size[np.lexsort((size[:, axis], group)), axis] for axis in range(2)])
        scale = np.maximum(1.4826 * 0.5 * (ranked[middle[0]] + ranked[middle[1]]), LEAST_SCALE_M)[group]
        weight = 1.0 / (1.0 + (residual / (CAUCHY * scale)) ** 2)
    return slope[start], np.asarray(scale * np.sqrt(w / determinant))[start]
