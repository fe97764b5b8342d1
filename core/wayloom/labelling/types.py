"""Results of the labelling: point labels and sparse vote vectors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SparseVotes:
    """start (P + 1,) int64: the votes of point p; classes (M,) uint8, increasing within a point; weights (M,) float32, > 0."""

    start: NDArray[np.int64]
    classes: NDArray[np.uint8]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PointLabels:
    """Labels of the odometry's P points, train ids, 255 where the network says nothing.

    baseline, mono, stereo  (P,) uint8: the host image's own label L_i(p); TCL over left images; TCL over left and right images
    vote_start              (P + 1,) int64: the (sparse) vote vector of point p, of the stereo form
    vote_class              (M,) uint8, increasing within a point
    vote_weight             (M,) float32, > 0, 1/m: sum of the votes for that class, inverse depths (eq. 3) times what the settings
                            weigh them by besides
    """

    baseline: NDArray[np.uint8]
    mono: NDArray[np.uint8]
    stereo: NDArray[np.uint8]
    vote_start: NDArray[np.int64]
    vote_class: NDArray[np.uint8]
    vote_weight: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.baseline)

    def without_votes(self) -> "PointLabels":
        """The labels alone: of a long drive the votes are most of it."""
        none = np.zeros(len(self) + 1, np.int64), np.zeros(0, np.uint8), np.zeros(0, np.float32)
        return PointLabels(self.baseline, self.mono, self.stereo, *none)
