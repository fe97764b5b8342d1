"""Exhaustive search of heading and place: correlation of bird's-eye layers over all shifts, for each heading.

A layer is the density of one group's points. Points of one view that stand where the other looked through count against a
pose. Each heading takes one product in the Fourier domain for all shifts.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wayloom.registration.scene import BAND_M, POLES, STRUCTURE, VEGETATION, VOXEL_M, Scene
from wayloom.registration.settings import RegistrationSettings

FloatArray = NDArray[np.float64]
CELLS: Final = 256
"""Cells to a side, VOXEL_M each, a power of two for the transform."""
SURE_M: Final = 1.0
"""Points less certain along their ray stay out of the layers."""
MOST_IN_CELL: Final = 4.0
WEIGHTS: Final = {STRUCTURE: 1.0, POLES: 2.0, VEGETATION: 0.5}
FREE_WEIGHT: Final = 1.0
APART_M, APART_RAD = 2.5, np.deg2rad(7.0)
"""Peaks nearer than this are one."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Where to search: mean (3,) of x, y in m and yaw in rad, their covariance (3, 3); all headings where it is None."""

    mean: FloatArray
    covariance: FloatArray | None
    reach_m: float
    sigmas: float

    def yaws(self, step: float) -> FloatArray:
        """Headings to try, rad."""
        if self.covariance is None:
            return np.asarray(np.arange(round(2.0 * np.pi / step)) * step, np.float64)
        half = self.sigmas * float(np.sqrt(self.covariance[2, 2])) + step
        count = min(int(np.ceil(half / step)), int(np.pi / step))
        return np.asarray(self.mean[2] + np.arange(-count, count + 1) * step, np.float64)

    def allowed(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """Whether shifts are near enough; x and y broadcast."""
        dx, dy = x - self.mean[0], y - self.mean[1]
        if self.covariance is None:
            return np.asarray(dx * dx + dy * dy <= self.reach_m**2)
        information = np.linalg.inv(self.covariance[:2, :2] + VOXEL_M**2 * np.eye(2))
        distance2 = information[0, 0] * dx * dx + 2.0 * information[0, 1] * dx * dy + information[1, 1] * dy * dy
        return np.asarray(distance2 <= self.sigmas**2)


def hypotheses(a: Scene, b: Scene, gate: Gate, settings: RegistrationSettings) -> list[tuple[FloatArray, float]]:
    """The best T_a_b (4, 4), level, at most `settings.hypotheses`, with their scores, best first."""
    spectrum_a = scipy.fft.rfft2(_layers(a, 0.0, blurred=True))
    shifts = np.asarray(np.fft.fftfreq(CELLS, 1.0 / CELLS) * VOXEL_M, np.float64)
    allowed = gate.allowed(shifts[:, None], shifts[None, :])
    peaks: list[tuple[float, float, float, float]] = []
    for yaw in gate.yaws(np.deg2rad(settings.yaw_step_deg)):
        spectrum_b = scipy.fft.rfft2(_layers(b, float(yaw), blurred=False))
        product = np.einsum("lij,lij->ij", spectrum_a[:-2], np.conj(spectrum_b[:-2]))
        product -= FREE_WEIGHT * (spectrum_a[-2] * np.conj(spectrum_b[-1]) + spectrum_a[-1] * np.conj(spectrum_b[-2]))
        score = np.where(allowed, scipy.fft.irfft2(product, (CELLS, CELLS)), -np.inf)
        peaks += [(s, shifts[i], shifts[j], float(yaw)) for s, i, j in _best_cells(score, settings.hypotheses)]
    return _distinct(peaks, settings.hypotheses)


def _layers(scene: Scene, yaw: float, blurred: bool) -> NDArray[np.float32]:
    """(L, CELLS, CELLS): one layer a group, then free and occupied cells of the band; turned by yaw."""
    sure = scene.sigma_m < SURE_M
    c, s = np.cos(yaw), np.sin(yaw)
    layers = np.zeros((len(WEIGHTS) + 2, CELLS, CELLS), np.float32)
    for number, (group, weight) in enumerate(WEIGHTS.items()):
        count = _histogram(scene.xyz[sure & (scene.group == group)], c, s)
        layers[number] = np.sqrt(weight) * np.sqrt(np.minimum(count, MOST_IN_CELL))
        if blurred:
            layers[number] = gaussian_filter(layers[number], 1.0)
    z = scene.xyz[:, 2]
    low = sure & (z > BAND_M[0]) & (z < BAND_M[1]) & (scene.group != 0)
    occupied = _histogram(scene.xyz[low], c, s) > 0
    layers[-2] = (_histogram(scene.free_cells, c, s) > 0) & ~occupied
    layers[-1] = occupied
    return layers


def _histogram(points: FloatArray, c: float, s: float) -> NDArray[np.float32]:
    """(CELLS, CELLS) points a cell, turned by the angle of c and s; those outside are left out."""
    x = np.floor((c * points[:, 0] - s * points[:, 1]) / VOXEL_M).astype(np.int64) + CELLS // 2
    y = np.floor((s * points[:, 0] + c * points[:, 1]) / VOXEL_M).astype(np.int64) + CELLS // 2
    inside = (x >= 0) & (y >= 0) & (x < CELLS) & (y < CELLS)
    counts = np.bincount(x[inside] * CELLS + y[inside], minlength=CELLS * CELLS)
    return counts.reshape(CELLS, CELLS).astype(np.float32)


def _best_cells(score: NDArray[Any], count: int) -> list[tuple[float, int, int]]:
    """The highest cells of one heading, none beside a higher one."""
    score, reach, out = score.copy(), int(APART_M / VOXEL_M), []
    for _ in range(count):
        i, j = np.unravel_index(int(np.argmax(score)), score.shape)
        if not np.isfinite(score[i, j]):
            break
        out.append((float(score[i, j]), int(i), int(j)))
        rows, columns = np.arange(i - reach, i + reach + 1) % CELLS, np.arange(j - reach, j + reach + 1) % CELLS
        score[np.ix_(rows, columns)] = -np.inf
    return out


def _distinct(peaks: list[tuple[float, float, float, float]], count: int) -> list[tuple[FloatArray, float]]:
    """The highest peaks, each unlike all higher ones."""
    out: list[tuple[float, float, float, float]] = []
    for peak in sorted(peaks, key=lambda p: (-p[0], p[1:])):
        if len(out) == count:
            break
        if all(np.hypot(peak[1] - o[1], peak[2] - o[2]) > APART_M or abs(turn(peak[3] - o[3])) > APART_RAD for o in out):
            out.append(peak)
    return [(level_pose(x, y, 0.0, yaw), score) for score, x, y, yaw in out]


def turn(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def level_pose(x: float, y: float, z: float, yaw: float) -> FloatArray:
    """(4, 4) turn about z and shift, rad and m."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T
