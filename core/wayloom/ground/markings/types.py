"""Markings and kerbs as geometry."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
LINES: Final = ("dash", "solid", "stop_line")
KINDS: Final = (*LINES, "zebra", "arrow", "symbol")


@dataclass(frozen=True)
class Marking:
    """Paint on the road, in a frame whose z is up.

    kind           one of KINDS
    line           (N, 3) m: its middle, from end to end; of a zebra from its first to its last bar, of a symbol its long axis
    ring           (M, 3) m: its outline, counter-clockwise, the last point is the first again
    width_m        of the line, or of a zebra's bars; of a symbol its extent across
    length_m       along the line, or of a zebra's bars; of a symbol its extent along
    sigma_m        of the middle's position across the line, of an end's along it, and of the width; (3,)
    confidence     probability that it is paint, 0 to 1
    open           whether it goes on where nothing is seen, at the line's first and last point
    bars, period_m how many bars a zebra has, and from one to the next; 0 of others
    """

    kind: str
    line: FloatArray
    ring: FloatArray
    width_m: float
    length_m: float
    sigma_m: FloatArray
    confidence: float
    open: tuple[bool, bool] = (False, False)
    bars: int = 0
    period_m: float = 0.0

    @property
    def covariance(self) -> FloatArray:
        """(2, 2) m^2 of its position in the plane."""
        d = self.line[-1, :2] - self.line[0, :2]
        d = d / max(float(np.hypot(*d)), 1e-9)
        axes = np.column_stack([d, [-d[1], d[0]]])
        return np.asarray(axes @ np.diag(self.sigma_m[[1, 0]] ** 2) @ axes.T)

    def moved(self, T_to_from: FloatArray) -> "Marking":
        """The same in another frame whose z is up, too."""
        return replace(self, line=se3.transform(T_to_from, self.line), ring=se3.transform(T_to_from, self.ring))


@dataclass(frozen=True)
class Kerb:
    """A step between road and what lies beside it, in a frame whose z is up.

    line            (N, 3) m along its foot, on the road's height, with the road on its left
    height_m        (N,) of the step
    sigma_m         (2,) of the line's position across it, and of the height, m
    confidence      0 to 1
    """

    line: FloatArray
    height_m: FloatArray
    sigma_m: FloatArray
    confidence: float

    @property
    def length_m(self) -> float:
        """Along the line."""
        return float(np.linalg.norm(np.diff(self.line, axis=0), axis=1).sum())

    def moved(self, T_to_from: FloatArray) -> "Kerb":
        """The same in another frame whose z is up, too."""
        return replace(self, line=se3.transform(T_to_from, self.line))
