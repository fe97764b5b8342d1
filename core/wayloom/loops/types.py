"""Loop closures of a drive."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoopClosures:
    """L verified closures between keyframes of one drive.

    first, second  (L,) int32 rows in Keyframes, first < second
    T_first_second (L, 4, 4) from the second's left camera to the first's
    covariance     (L, 6, 6) of the left perturbation (v, omega) of T_first_second, m^2 and rad^2
    report         JSON-ready facts: candidates, what was refused and why
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    T_first_second: FloatArray
    covariance: FloatArray
    report: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.first)


def no_loops() -> LoopClosures:
    """None found."""
    none = np.zeros(0, np.int32)
    return LoopClosures(none, none, np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))
