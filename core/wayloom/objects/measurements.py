"""Measurements: what single keyframes show of poles, trunks, signs and lights."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measurements:
    """N measurements.

    view                row of the view (N,)
    kind                row of KINDS (N,)
    uvd                 (N, 3) px: middle column and row, disparity without bias
    sigma               (N, 3) px
    low, high           (N,) m, level frame: heights of its ends
    cut_low, cut_high   (N,) whether the image ends there, so that it may go on
    width               (N,) m
    free                (N, 2) -1 to 1: what is beside it, left and right: further away (1), as far (-1), not known (0)
    goes_on             (N,) of poles and trunks, whether something as near stands above where their label ends: 1 or 0; else NaN
    stripe              (N,) of signs, how much brighter than beside it a stripe down their middle is, as of a post; else NaN
    slope, slope_sigma  (N,) 1/px: change of disparity along columns over the disparity, of signs; NaN where it is not known
    """

    view: NDArray[np.int64]
    kind: NDArray[np.int64]
    uvd: FloatArray
    sigma: FloatArray
    low: FloatArray
    high: FloatArray
    cut_low: NDArray[np.bool_]
    cut_high: NDArray[np.bool_]
    width: FloatArray
    free: FloatArray
    goes_on: FloatArray
    stripe: FloatArray
    slope: FloatArray
    slope_sigma: FloatArray

    def __len__(self) -> int:
        return len(self.view)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> "Measurements":
        """Those in these rows."""
        return Measurements(*(getattr(self, one.name)[rows] for one in fields(self)))


def joined(parts: Iterable[Measurements]) -> Measurements:
    """All measurements of all parts, of which there is at least one."""
    listed = list(parts)
    return Measurements(*(np.concatenate([getattr(part, one.name) for part in listed]) for one in fields(Measurements)))
