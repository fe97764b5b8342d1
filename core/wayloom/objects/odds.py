"""Log-odds of a drive's track by the facts of its views: a logistic regression, fitted on simulated drives."""

from dataclasses import astuple, dataclass
from typing import Final

import numpy as np

from wayloom.objects.evidence import Facts
from wayloom.objects.types import LIGHT, POLE, SIGN, TRUNK


@dataclass(frozen=True, slots=True)
class Weights:
    """Of the facts of a track (`evidence.Facts`).

    one              of all tracks alike
    looks            of their logarithm over LEAST
    free, least_free of how free it stands on both sides, and on the worse one
    unseen           of views that do not show it, over looks
    carries          of a sign or light that it carries
    goes_on, stub    of something as near above where its label ends: of all, and of those shorter than STUB_M

    Pillars of fronts and the trunks of trees go on above what a network takes for a pole; of a trunk it is mostly a stub.
    """

    one: float
    looks: float
    free: float
    least_free: float
    unseen: float
    carries: float = 0.0
    goes_on: float = 0.0
    stub: float = 0.0


WEIGHTS: Final = {
    POLE: Weights(one=2.0, looks=0.9, free=2.4, least_free=2.4, unseen=-1.2, carries=2.7, goes_on=-1.9, stub=-1.2),
    SIGN: Weights(one=1.4, looks=1.6, free=1.8, least_free=0.6, unseen=-0.8),
    LIGHT: Weights(one=1.4, looks=1.6, free=1.8, least_free=0.6, unseen=-0.8),
    TRUNK: Weights(one=1.3, looks=0.3, free=2.2, least_free=2.1, unseen=-0.8),
}
STUB_M: Final = 1.5
LEAST: Final = 3.0
MOST_UNSEEN: Final = 2.0


def odds_of(kind: int, facts: Facts) -> tuple[float, float]:
    """Log-odds for and against; neither is negative."""
    unseen = min((facts.unseen + facts.through) / facts.looks, MOST_UNSEEN)
    stub = facts.goes_on if facts.height < STUB_M else 0.0
    told = Weights(1.0, np.log(facts.looks / LEAST), facts.free, facts.least_free, unseen, facts.carries, facts.goes_on, stub)
    terms = np.array(astuple(told)) * astuple(WEIGHTS[kind])
    return float(terms[terms > 0.0].sum()), float(-terms[terms < 0.0].sum())
