"""Log-odds of a drive's track by the facts of its views: a logistic regression, fitted on simulated drives."""

from typing import Final

import numpy as np

from wayloom.objects.evidence import Facts
from wayloom.objects.types import LIGHT, POLE, SIGN, TRUNK

WEIGHTS: Final = {
    POLE: (1.3, 0.3, 2.2, 2.1, -0.8), TRUNK: (1.3, 0.3, 2.2, 2.1, -0.8),
    SIGN: (1.9, 0.4, 1.0, 0.9, -1.4), LIGHT: (1.9, 0.4, 1.0, 0.9, -1.4),
}  # fmt: skip
"""Of one, of the logarithm of the looks over LEAST, of how free it stands on both sides, and on the worse one, and of views that do
not show it over looks."""
LEAST: Final = 3.0
MOST_UNSEEN: Final = 2.0


def odds_of(kind: int, facts: Facts) -> tuple[float, float]:
    """Log-odds for and against; neither is negative."""
    unseen = min((facts.unseen + facts.through) / facts.looks, MOST_UNSEEN)
    terms = np.array([1.0, np.log(facts.looks / LEAST), facts.free, facts.least_free, unseen]) * WEIGHTS[kind]
    return float(terms[terms > 0.0].sum()), float(-terms[terms < 0.0].sum())
