"""Viewpoints: orthographic from above, oblique that fits a scene, and flights along a drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

FloatArray = NDArray[np.float64]
FIELD_OF_VIEW_DEG: Final = 36.0
ELEVATION_DEG: Final = 38.0
SHOWN_SHARE: Final = 0.0005
"""Of the points that may lie beyond the picture's edge at each side: strays do not make the rest small."""
MARGIN: Final = 1.1
NEAR_M: Final = 0.5
FLY_VIEW_DEG: Final = 61.0
FLY_HEIGHT_M: Final = 4.5
FLY_BACK_M: Final = 9.0
FLY_AHEAD_M: Final = 14.0
SMOOTH_M: Final = 6.0
STEP_M: Final = 0.5


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """A virtual camera; pixel (0, 0) is the centre of the top-left one.

    T_view_scene  (4, 4): x right, y down, z away from the viewer
    size_px       width, height
    focal_px      of a perspective view; None: orthographic
    metre_px      pixels a metre of an orthographic one
    """

    T_view_scene: FloatArray
    size_px: tuple[int, int]
    focal_px: float | None = None
    metre_px: float = 1.0

    def project(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """uv (N, 2) px, depth (N,) m and pixels a metre there (N,), of points (N, 3) m. Behind the viewer depth is negative."""
        R, t = self.T_view_scene[:3, :3].astype(np.float32), self.T_view_scene[:3, 3].astype(np.float32)
        p_view = points @ R.T + t
        depth: NDArray[np.float32] = p_view[:, 2]
        scale: NDArray[np.float32]
        if self.focal_px is None:
            scale = np.asarray(np.full(len(points), self.metre_px), np.float32)
        else:
            depth = np.where(depth > NEAR_M, depth, np.float32(-1.0))
            scale = np.asarray(self.focal_px / np.where(depth > 0.0, depth, 1.0), np.float32)
        centre = (np.array(self.size_px, np.float32) - 1.0) / 2.0
        return p_view[:, :2] * scale[:, None] + centre, depth, scale

    def enlarged(self, times: int) -> "Viewpoint":
        """The same view with so many times the pixels along each edge."""
        width, height = self.size_px
        focal = None if self.focal_px is None else self.focal_px * times
        return Viewpoint(self.T_view_scene, (width * times, height * times), focal, self.metre_px * times)


def looking(eye: FloatArray, target: FloatArray) -> FloatArray:
    """T_view_scene (4, 4) of a viewer at `eye` (3,) that looks at `target` with the horizon level."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-9 else x / np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ eye
    return T


def from_above(points: NDArray[np.float32], longest_px: int) -> Viewpoint:
    """North, or ahead, is up; the picture is as wide and high as what there is, but no slimmer than one to three."""
    low, high = _reach(points)
    edges = np.maximum(high[:2] - low[:2], 5.0) * MARGIN
    edges = np.maximum(edges, edges.max() / 3.0)
    metre_px = longest_px / float(edges.max())
    width, height = (max(2, 2 * round(metre_px * edge / 2)) for edge in edges)
    middle = 0.5 * (low + high)
    eye = np.array([middle[0], middle[1], float(points[:, 2].max()) + 10.0])
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = -T[:3, :3] @ eye
    return Viewpoint(T, (width, height), metre_px=metre_px)


def oblique(
    points: NDArray[np.float32], size_px: tuple[int, int], azimuth_deg: float | None = None, ways: Sequence[FloatArray] = ()
) -> Viewpoint:
    """From one side, at 38° over the horizon, as near as the scene fits.

    azimuth_deg : to which the viewer looks, clockwise from north; None: across the direction in which the scene is longest
    ways        : (K, 3) m each, that have to be in the picture from end to end; of the points strays need not
    """
    low, high = _reach(points)
    way = np.concatenate([np.zeros((0, 3)), *ways]).astype(np.float32)
    target = np.array([*(0.5 * (low[:2] + high[:2])), float(np.median(points[:, 2]))])
    azimuth = np.radians(_across(points) if azimuth_deg is None else azimuth_deg)
    lift = np.radians(ELEVATION_DEG)
    back = -np.array([np.sin(azimuth) * np.cos(lift), np.cos(azimuth) * np.cos(lift), -np.sin(lift)])
    focal = 0.5 * size_px[0] / np.tan(0.5 * np.radians(FIELD_OF_VIEW_DEG))
    distance = 1.2 * float(np.linalg.norm(high - low))
    view = Viewpoint(looking(target + distance * back, target), size_px, focal)
    for _ in range(6):  # the nearer, the stronger the perspective: fitting is repeated
        uv, depth, _ = view.project(points)
        uv = uv[depth > 0.0].astype(np.float64)
        left, right = np.quantile(uv, [SHOWN_SHARE, 1.0 - SHOWN_SHARE], axis=0)
        on_way, way_depth, _ = view.project(way)
        on_way = on_way[way_depth > 0.0].astype(np.float64)
        left, right = np.minimum(left, on_way.min(axis=0, initial=np.inf)), np.maximum(right, on_way.max(axis=0, initial=-np.inf))
        shift = 0.5 * (left + right) - (np.array(size_px) - 1.0) / 2.0
        right_dir, down_dir = view.T_view_scene[0, :3], view.T_view_scene[1, :3]
        target = target + distance / focal * (shift[0] * right_dir + shift[1] * down_dir)
        distance *= float(np.max((right - left) * MARGIN / np.array(size_px)))
        view = Viewpoint(looking(target + distance * back, target), size_px, focal)
    return view


def street_level(track: FloatArray, size_px: tuple[int, int]) -> Viewpoint:
    """From the middle of a way (K, 3) m, over the vehicle, along it."""
    views = [*flight(track, size_px, 5)]
    return views[len(views) // 2]


def flight(track: FloatArray, size_px: tuple[int, int], frames: int) -> Iterator[Viewpoint]:
    """Views of a viewer who follows a way (K, 3) m above and behind its camera, at an even pace."""
    way, lead = _smooth(track), round(FLY_BACK_M / STEP_M)
    focal = 0.5 * size_px[0] / np.tan(0.5 * np.radians(FLY_VIEW_DEG))
    last = max(len(way) - 1 - lead - round(FLY_AHEAD_M / STEP_M), 1)
    for at in np.linspace(0.0, last, frames):
        eye = _along(way, at) + np.array([0.0, 0.0, FLY_HEIGHT_M])
        target = _along(way, at + lead + FLY_AHEAD_M / STEP_M) - np.array([0.0, 0.0, 0.5])
        yield Viewpoint(looking(eye, target), size_px, focal)


def _smooth(track: FloatArray) -> FloatArray:
    """The way in steps of half a metre, its corners rounded, with a straight piece before it where the viewer starts."""
    steps = np.linalg.norm(np.diff(track, axis=0), axis=1)
    keep = np.r_[True, steps > 1e-3]
    road = np.r_[0.0, np.cumsum(steps)][keep]
    at = np.arange(0.0, max(road[-1], 2.0 * STEP_M), STEP_M)
    even = np.column_stack([np.interp(at, road, track[keep, axis]) for axis in range(3)])
    ahead = even[min(len(even) - 1, round(SMOOTH_M / STEP_M))] - even[0]
    spare = round(2.0 * SMOOTH_M / STEP_M)  # smoothing bends the ends
    back = np.arange(round(FLY_BACK_M / STEP_M) + spare, 0, -1)[:, None] * STEP_M
    even = np.vstack([even[0] - back * ahead / max(float(np.linalg.norm(ahead)), 1e-6), even])
    return np.asarray(gaussian_filter1d(even, SMOOTH_M / STEP_M / 2.0, axis=0, mode="nearest")[spare:])


def _along(way: FloatArray, at: float) -> FloatArray:
    rows = np.arange(len(way))
    return np.array([np.interp(at, rows, way[:, axis]) for axis in range(3)])


def _reach(points: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Low and high corner (3,) of all but strays."""
    low, high = np.quantile(points.astype(np.float64), [SHOWN_SHARE, 1.0 - SHOWN_SHARE], axis=0)
    return low, high


def _across(points: NDArray[np.float32]) -> float:
    """Azimuth in degrees across the main direction of the points; of the two that one that looks more to the north."""
    centred = points[:: max(1, len(points) // 20_000), :2].astype(np.float64)
    along = np.linalg.svd(centred - centred.mean(axis=0), full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    across = across if across[1] >= 0.0 else -across
    return float(np.degrees(np.arctan2(across[0], across[1])))
