"""Log-odds of looks that nothing stands where a thing is: what each word of a look weighs, by kind.

Weights are of ln P(word | nothing is there) - ln P(word | it stands), where `benchmarks/change.py rates` counts the words of looks
on things of simulated drives. They were set on the first such count and lie up to one below today's: looks of one drive err
together. Leaves and walls are seen through for reasons that last (gaps, poses): theirs are far under the count.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import BUILT, GREEN, MOVING, THIN
from wayloom.stitching.sightings import Sightings

FloatArray = NDArray[np.float64]
WEIGHTS: Final = {THIN: (3.7, 0.8, -2.3), MOVING: (4.4, 1.0, -1.0), GREEN: (2.3, 0.0, -4.6), BUILT: (2.3, 0.0, -4.6)}
"""Of a look that sees through, of one that is bare, and of one that sees it."""


def log_odds(sights: Sightings, kind: NDArray[np.uint8]) -> FloatArray:
    """(D, T) that there is nothing where T things of kinds (T,) are, by the looks of each of D drives; 0 without a look."""
    weights = np.zeros((256, 3))
    for bit, row in WEIGHTS.items():
        weights[bit] = row
    through, bare, seen = weights[kind].T
    return np.asarray(through * sights.through + bare * sights.bare + seen * sights.seen)
