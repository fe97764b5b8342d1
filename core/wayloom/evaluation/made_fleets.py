"""Made fleets with exact truth: drives over a grid of streets with GNSS of each kind, and their meetings.

A drive's errors are those of a small smoother, solved exactly: submaps joined by odometry (white noise and a share for the scale),
a fix at each submap with an error that wanders (Ornstein-Uhlenbeck over the road). Its posterior covariance is what the drive
states, and its error is drawn from it, whole: neighbours err together as they would.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.stitching.types import DrivePlaces, Meeting

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KINDS: Final = {"RTK": 0.02, "float": 0.4, "single": 2.0, "none": np.inf}
"""Sigma of the fixes' wandering error, m, each axis."""
WANDER_M = 300.0
SUBMAP_M = 75.0
MEETING_M, MEETING_RAD = 0.05, np.radians(0.15)
ODOMETRY_M, ODOMETRY_RAD, SCALE = 0.005, np.radians(0.02), 0.002
LEVEL_RAD, HEADING_RAD = np.radians(0.15), np.radians(0.15)
NEAR_M = 30.0


@dataclass(frozen=True, slots=True)
class MadeFleet:
    """Drives and meetings; truth T_map_submap of each drive; kind of each drive; false (M,) marks of the meetings."""

    drives: list[DrivePlaces]
    meetings: list[Meeting]
    truth: dict[str, FloatArray]
    kind: dict[str, str]
    false: NDArray[np.bool_]


def made_fleet(
    drives: int, seed: int, submaps: int = 20, false_share: float = 0.1, side: int = 0, with_cross: bool = False
) -> MadeFleet:
    """Drives of the four kinds in turn (each fifth without GNSS, each fourth of the others RTK) over a grid of `side` streets of
    150 m blocks; side 0 takes 4 streets for ten drives, and grows with the fleet at the same density.

    with_cross: whether the drives tell the covariance of neighbours
    """
    rng = np.random.default_rng(seed)
    side = side or max(3, round(4.0 * np.sqrt(drives / 10.0)))
    names = [f"drive-{k:04d}" for k in range(drives)]
    kinds = [("none" if k % 5 == 4 else ("RTK", "float", "single", "single")[(k - k // 5) % 4]) for k in range(drives)]
    truth = {name: _drive(submaps, side, rng) for name in names}
    made = [_placed(name, kind, truth[name], with_cross, rng) for name, kind in zip(names, kinds, strict=True)]
    meetings = _meetings(names, truth, rng)
    count = round(false_share * len(meetings))
    false = [_false(names, truth, rng) for _ in range(count)]
    mark = np.arange(len(meetings) + count) >= len(meetings)
    return MadeFleet(made, meetings + false, truth, dict(zip(names, kinds, strict=True)), mark)


def _drive(submaps: int, side: int, rng: np.random.Generator) -> FloatArray:
    """(n, 4, 4): two submaps a block, turning at random at crossings and never around; the camera looks along the street."""
    at, heading = rng.integers(0, side, 2), np.array([1, 0])
    xy: list[FloatArray] = []
    ahead: list[IntArray] = []
    while len(xy) < submaps:
        ways = [np.array(way) for way in ((1, 0), (-1, 0), (0, 1), (0, -1)) if len(xy) == 0 or (np.array(way) != -heading).any()]
        ways = [way for way in ways if ((at + way >= 0) & (at + way < side)).all()]
        heading = ways[rng.integers(len(ways))]
        for share in (0.25, 0.75):
            xy.append((at + share * heading) * 2.0 * SUBMAP_M + rng.normal(0.0, 2.0, 2))
            ahead.append(heading)
        at = at + heading
    p, forward = np.array(xy)[:submaps], np.array(ahead, np.float64)[:submaps]
    R = np.zeros((submaps, 3, 3))
    R[:, 0, 0], R[:, 1, 0] = forward[:, 1], -forward[:, 0]
    R[:, 2, 1] = -1.0
    R[:, :2, 2] = forward
    return se3.from_rotation_translation(R, np.column_stack([p, np.zeros(submaps)]))


def _placed(name: str, kind: str, truth: FloatArray, with_cross: bool, rng: np.random.Generator) -> DrivePlaces:
    n, sigma = len(truth), KINDS[kind]
    J = np.zeros((6 * n, 6 * n))  # information of the left perturbations, about the map's origin
    for k in range(n - 1):
        L = float(np.linalg.norm(truth[k + 1, :3, 3] - truth[k, :3, 3]))
        turn2 = ODOMETRY_RAD**2 * L
        variance = np.repeat([ODOMETRY_M**2 * L + turn2 * L**2 / 12.0 + (SCALE * L) ** 2, turn2], 3)
        Ad = se3.adjoint(_shift(-0.5 * (truth[k, :3, 3] + truth[k + 1, :3, 3])))
        D = np.zeros((6, 6 * n))
        D[:, 6 * k : 6 * k + 6], D[:, 6 * k + 6 : 6 * k + 12] = -Ad, Ad
        J += D.T @ (D / variance[:, None])
    at = [se3.adjoint(_shift(-T[:3, 3])) for T in truth]
    if np.isfinite(sigma):
        road = SUBMAP_M * np.arange(n)
        fixes = np.linalg.inv(sigma**2 * np.exp(-np.abs(road[:, None] - road) / WANDER_M) + 1e-4 * np.eye(n))
        for i in range(n):
            for k in range(n):
                J[6 * i : 6 * i + 6, 6 * k : 6 * k + 6] += fixes[i, k] * at[i][:3].T @ at[k][:3]
    for k in range(n):  # level, and where there is GNSS a heading by it
        turn = np.diag([0.0, 0.0, 0.0, LEVEL_RAD**-2, LEVEL_RAD**-2, 0.0]) / n
        J[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += at[k].T @ turn @ at[k]
    if not np.isfinite(sigma):
        J[:6, :6] += at[0].T @ np.diag([1e6, 1e6, 1e6, 0.0, 0.0, 1e8]) @ at[0]
    P = np.linalg.inv(0.5 * (J + J.T))
    P = 0.5 * (P + P.T)
    xi = (np.linalg.cholesky(P) @ rng.normal(size=6 * n)).reshape(n, 6)
    T = se3.exp(xi) @ truth
    own = [P[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(n)]
    beside = [P[6 * k : 6 * k + 6, 6 * k + 6 : 6 * k + 12] for k in range(n - 1)]
    covariance, cross = np.array(own), np.array(beside).reshape(-1, 6, 6)
    located = bool(np.isfinite(sigma))
    if not located:  # seen from its own level frame, which begins at its first submap
        T_own_map = _own_frame(truth[0])
        Ad = se3.adjoint(T_own_map)
        T, covariance, cross = T_own_map @ T, Ad @ covariance @ Ad.T, Ad @ cross @ Ad.T
    tells = cross if with_cross else None
    return DrivePlaces(name, T, covariance, np.full(n, SUBMAP_M), np.ones(n - 1, np.bool_), tells, located)


def _own_frame(T_map_first: FloatArray) -> FloatArray:
    """T_own_map (4, 4): the first camera at the origin, looking along the second axis, up the third."""
    ahead = T_map_first[:2, 2]
    turn = np.array([[ahead[1], -ahead[0], 0.0], [ahead[0], ahead[1], 0.0], [0.0, 0.0, 1.0]])
    return se3.from_rotation_translation(turn, -turn @ T_map_first[:3, 3])


def _meetings(names: list[str], truth: dict[str, FloatArray], rng: np.random.Generator) -> list[Meeting]:
    """Of each pair of drives, those submaps that lie within NEAR_M; on average every second one is found."""
    out = []
    drive = np.repeat(np.arange(len(names)), [len(truth[name]) for name in names])
    number = np.concatenate([np.arange(len(truth[name])) for name in names])
    T = np.concatenate([truth[name] for name in names])
    cell = np.floor(T[:, :2, 3] / SUBMAP_M).astype(int)
    by_cell: dict[tuple[int, int], list[int]] = {}
    for row, (i, j) in enumerate(cell.tolist()):
        by_cell.setdefault((i, j), []).append(row)
    for row, (i, j) in enumerate(cell.tolist()):
        near = [other for di in (-1, 0, 1) for dj in (-1, 0, 1) for other in by_cell.get((i + di, j + dj), [])]
        for other in sorted(near):
            apart = np.linalg.norm(T[row, :3, 3] - T[other, :3, 3])
            if drive[other] > drive[row] and apart < NEAR_M and rng.random() < 0.5:
                true = se3.inverse(T[row]) @ T[other]
                out.append(_measured(names[drive[row]], number[row], names[drive[other]], number[other], true, rng))
    return out


def _false(names: list[str], truth: dict[str, FloatArray], rng: np.random.Generator) -> Meeting:
    """Of any two submaps of two drives, by a step as long as those of right ones: as sure, and wrong."""
    a, b = rng.choice(len(names), 2, replace=False)
    i, j = rng.integers(0, [len(truth[names[a]]), len(truth[names[b]])])
    step = np.concatenate([rng.uniform(-NEAR_M, NEAR_M, 3) * [0.5, 0.1, 1.0], [0.0, rng.uniform(-np.pi, np.pi), 0.0]])
    return _measured(names[a], i, names[b], j, se3.exp(step), rng)


def _measured(a: str, i: np.int64, b: str, j: np.int64, T_a_b: FloatArray, rng: np.random.Generator) -> Meeting:
    sigma = np.repeat([MEETING_M, MEETING_RAD], 3)
    return Meeting(a, int(i), b, int(j), se3.exp(sigma * rng.normal(size=6)) @ T_a_b, np.diag(sigma**2))


def _shift(t: FloatArray) -> FloatArray:
    return se3.from_rotation_translation(np.eye(3), t)
