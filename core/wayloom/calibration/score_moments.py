"""Moments of the match groups' scores: what the sandwich estimator needs of drives whose observations are gone.

The score of match group s at a lens x (difference from the ideal camera's) is linear about the lens at which it was taken,

    s_s(x) = s_s(0) - h_s x,

h_s being its curvature. Every sum over groups that is quadratic in scores and curvatures follows, at any x, from the second moments
of y_s = (1, s_s(0), upper triangle of h_s), and moments of drives add. So drives given one by one leave what all at once leave.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.lens import PARAMETERS

FloatArray = NDArray[np.float64]
COUNT: Final = len(PARAMETERS)
ROWS, COLUMNS = np.triu_indices(COUNT)
SIZE: Final = 1 + COUNT + len(ROWS)
"""Of y."""
_SCORE, _CURVATURE = slice(1, 1 + COUNT), slice(1 + COUNT, SIZE)
_AT: Final = np.zeros((COUNT, COUNT), np.intp)
"""Where an entry of a curvature stands in its upper triangle."""
_AT[ROWS, COLUMNS] = _AT[COLUMNS, ROWS] = np.arange(len(ROWS))


@dataclass(frozen=True, slots=True)
class ScoreMoments:
    """Sums over drives.

    moments   (66, 66) sum of y y^T over match groups
    region_excess_px2, region_freedom   of the mean row residuals of the image's regions: their sum of squares beyond what the match
                  groups scatter, and its degrees of freedom; the ratio is the variance that the matches of a region share
    """

    moments: FloatArray = field(default_factory=lambda: np.zeros((SIZE, SIZE)))
    region_excess_px2: float = 0.0
    region_freedom: float = 0.0

    def __add__(self, other: "ScoreMoments") -> "ScoreMoments":
        return ScoreMoments(
            self.moments + other.moments,
            self.region_excess_px2 + other.region_excess_px2,
            self.region_freedom + other.region_freedom,
        )

    @property
    def groups(self) -> float:
        """Number of match groups."""
        return float(self.moments[0, 0])

    @property
    def curvature(self) -> FloatArray:
        """(10, 10) sum of the curvatures h."""
        return np.asarray(self.moments[0, _CURVATURE][_AT], np.float64)

    @property
    def shared_px2(self) -> float:
        """Variance, px^2, of the error that the matches of a region share."""
        return max(self.region_excess_px2 / self.region_freedom, 0.0) if self.region_freedom > 0 else 0.0

    def scatter(self, x: FloatArray) -> FloatArray:
        """(10, 10) sum of s(x) s(x)^T, x (10,)."""
        Q = self.moments
        by_curvature = np.einsum("iab,b->ia", Q[_SCORE, _CURVATURE][:, _AT], x)
        both = np.einsum("iajb,a,b->ij", self._curvature_moments(), x, x)
        return np.asarray(Q[_SCORE, _SCORE] - by_curvature - by_curvature.T + both)

    def leverage(self, inverse: FloatArray) -> FloatArray:
        """(10, 10) sum of h inverse h, inverse (10, 10)."""
        return np.asarray(np.einsum("iabj,ab->ij", self._curvature_moments(), inverse), np.float64)

    def _curvature_moments(self) -> FloatArray:
        """(10, 10, 10, 10) sum of h_ij h_kl."""
        return np.asarray(self.moments[_CURVATURE, _CURVATURE][_AT[:, :, None, None], _AT[None, None]], np.float64)


def moments_of(scores: FloatArray, curvatures: FloatArray, x: FloatArray) -> FloatArray:
    """(66, 66) of match groups with these scores (S, 10) at x (10,) and curvatures (S, 10, 10)."""
    ideal = scores + np.einsum("sij,j->si", curvatures, x)
    y = np.column_stack([np.ones(len(scores)), ideal, curvatures[:, ROWS, COLUMNS]])
    return np.asarray(y.T @ y)
