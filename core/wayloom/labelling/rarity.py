"""Rare classes' votes weigh more, where the network's training did not see to that.

Not in the paper. A network whose loss counts every pixel alike gives a thin or rare thing less than its due wherever it is not sure
(Menon et al., Long-tail learning via logit adjustment, ICLR 2021): at edges, where most of the odometry's points lie. Dividing its
probabilities by a power of each class's frequency makes up for it. The frequency is that of the drive's own votes: no truth is
asked for.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.labelling.kernels.neighbours import favoured, shares_of_classes
from wayloom.labelling.types import SparseVotes

LEAST_FREQUENCY: Final = 1e-4
"""Added to a class's share of the votes: what is hardly there at all is not made more of."""


def rarity_factors(votes: SparseVotes, power: float) -> NDArray[np.float64]:
    """(19,) by which a class's votes are multiplied: its share of the drive's votes to the power -power."""
    shares = shares_of_classes(votes.start, votes.classes, votes.weights, CLASS_COUNT)
    return np.asarray((shares + LEAST_FREQUENCY) ** -power, np.float64)


def favour(votes: SparseVotes, factors: NDArray[np.float64]) -> SparseVotes:
    """Votes times the factors (19,) of their classes; the sum of each point's votes stays."""
    return replace(votes, weights=favoured(votes.start, votes.classes, votes.weights, factors))
