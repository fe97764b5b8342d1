"""Log-odds of a drive's track by the facts of its views: a logistic regression, fitted on simulated drives."""

from typing import Final

import numpy as np

from wayloom.objects.evidence import Facts
from wayloom.objects.types import LIGHT, POLE, SIGN, TRUNK

WEIGHTS: Final = {
    POLE: (2.0, 0.9, 2.4, 2.4, -1.2, 2.7, -1.9, -1.2), TRUNK: (1.3, 0.3, 2.2, 2.1, -0.8, 0.0, 0.0, 0.0),
    SIGN: (1.4, 1.6, 1.8, 0.6, -0.8, 0.0, 0.0, 0.0), LIGHT: (1.4, 1.6, 1.8, 0.6, -0.8, 0.0, 0.0, 0.0),
}  # fmt: skip
"""Of one, of the logarithm of the looks over LEAST, of how free it stands on both sides, and on the worse one, of views that do not
show it over looks, of a sign or light that it carries, and of something as near above where its label ends: of all, and of stubs.

Pillars of fronts and the trunks of trees go on above what a network takes for a pole; of a trunk it is mostly a stub."""
STUB_M: Final = 1.5
LEAST: Final = 3.0
MOST_UNSEEN: Final = 2.0


def odds_of(kind: int, facts: Facts) -> tuple[float, float]:
    """Log-odds for and against; neither is negative."""
    unseen = min((facts.unseen + facts.through) / facts.looks, MOST_UNSEEN)
    stub = facts.goes_on if facts.height < STUB_M else 0.0
    of_views = 1.0, np.log(facts.looks / LEAST), facts.free, facts.least_free, unseen
    terms = np.array([*of_views, facts.carries, facts.goes_on, stub]) * WEIGHTS[kind]
    return float(terms[terms > 0.0].sum()), float(-terms[terms < 0.0].sum())
