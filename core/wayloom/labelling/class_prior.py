"""Class prior correction of votes (logit adjustment).

Not in the paper. A network whose loss counts every pixel alike favours frequent classes wherever it is not sure (Menon et al.,
Long-tail learning via logit adjustment, ICLR 2021). The correction divides the votes for class c by a power of its prior:

    v'_c = v_c (pi_c + epsilon)^-power,    scaled so that the sum of a point's votes stays

where the prior pi_c is the class's share of the drive's own votes; no truth is used.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.labelling.kernels.neighbours import class_priors, scaled_by_class
from wayloom.labelling.types import SparseVotes

PRIOR_EPSILON: Final = 1e-4
"""Added to a class's prior: bounds the factor of a class that is hardly there."""


def class_prior_factors(votes: SparseVotes, power: float) -> NDArray[np.float64]:
    """(19,) by which a class's votes are multiplied: (prior + epsilon)^-power."""
    priors = class_priors(votes.start, votes.classes, votes.weights, CLASS_COUNT)
    return np.asarray((priors + PRIOR_EPSILON) ** -power, np.float64)


def class_prior_correction(votes: SparseVotes, factors: NDArray[np.float64]) -> SparseVotes:
    """Votes times the factors (19,) of their classes; the sum of each point's votes stays."""
    return replace(votes, weights=scaled_by_class(votes.start, votes.classes, votes.weights, factors))
