"""Registration of one place view to another: a relative pose with covariance, or the reason of a refusal."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Registration:
    """Pose of view b in view a.

    T_a_b       (4, 4) from b's level frame to a's; meaningless where refused
    covariance  (6, 6) of the left perturbation (v, omega), m^2 and rad^2
    refused     why the pair is not taken, in words; empty where it is taken
    evidence    JSON-ready numbers that the judgement rests on
    """

    T_a_b: FloatArray
    covariance: FloatArray
    refused: str = ""
    evidence: dict[str, Any] = field(default_factory=dict)
