"""Remaining time of a drive as an interval, widened or narrowed by how earlier estimates turned out.

By this service's own history, and where that is thin by a prior, which is said. The factors around the estimate are split-conformal
(Vovk et al., Algorithmic Learning in a Random World, 2005): order statistics of truth / estimate over earlier drives. Where drives
are exchangeable the truth lies within at NOMINAL or a little more often, whatever the distribution.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

NOMINAL: Final = 0.8
"""Share of drives whose truth should lie within the interval that is told, as often missed below as above."""
LEAST: Final = 20
"""Judged estimates of a stage from which on they count more than the spreads below."""
SECONDS_A_FRAME: Final[Mapping[str, float]] = {
    "ingest": 0.01, "odometry": 0.074, "segmentation": 0.052, "labelling": 0.054, "places": 0.013, "looks": 0.076,
    "loops": 0.001,
    "georeference": 0.021, "submaps": 0.001, "ground": 0.185, "objects": 0.05, "stitch": 1.07, "publish": 0.001,
}  # fmt: skip
"""Prior of a stage that this service has never run, as `python benchmarks/eta_prior.py` prints it of a demo on a shared machine of
two cores. Only the proportions matter once a stage of the drive is done: how long that took tells how fast this machine is."""
OTHER_STAGE: Final = 0.02
USUAL_SPREAD: Final = (0.7, 1.5)
ROUGH_SPREAD: Final = (0.4, 2.5)

Learnt: TypeAlias = Mapping[tuple[str, bool], tuple[float, float]]
"""By stage and roughness of an estimate, the factors of its lower and upper end (`learn`)."""


class StageSoFar(Protocol):
    """A stage of a drive as far as it is; `seconds` since it began, or that it took."""

    @property
    def stage(self) -> str: ...
    @property
    def state(self) -> str: ...
    @property
    def progress(self) -> float: ...
    @property
    def seconds(self) -> float | None: ...


@dataclass(frozen=True, slots=True)
class Estimate:
    """Remaining time, s, told while `stage` is the first that is not done. rough : a stage to come was never seen here."""

    stage: str
    expected_s: float
    low_s: float
    high_s: float
    rough: bool


def estimate(stages: Sequence[StageSoFar], usual: Mapping[str, float], frames: int, learnt: Learnt) -> Estimate | None:
    """From what is left of each stage; None where all are done. usual : s by stage, of those that were ever done."""
    left = [stage for stage in stages if stage.state != "done"]
    if not left:
        return None
    pace = _pace(stages, frames)
    parts = [_left(stage, usual, pace, frames) for stage in left]
    expected = sum(seconds for seconds, _ in parts)
    rough = any(spread == ROUGH_SPREAD for _, spread in parts)
    low, high = (sum(spread[end] * seconds for seconds, spread in parts) for end in (0, 1))
    factors = learnt.get((left[0].stage, rough))
    if factors is not None:
        low, high = factors[0] * expected, factors[1] * expected
    return Estimate(left[0].stage, expected, low, high, rough)


def learn(ratios: Sequence[float]) -> tuple[float, float] | None:
    """Factors around an estimate within which a next drive's truth lies at the nominal share; None of fewer than LEAST ratios.

    ratios : truth / estimate of earlier drives. Of n of them the k-th least and the k-th greatest,
             k = floor((n + 1) (1 - NOMINAL) / 2)
    """
    if len(ratios) < LEAST:
        return None
    ordered = sorted(ratios)
    k = math.floor((len(ordered) + 1) * (1.0 - NOMINAL) / 2.0 + 1e-9)
    return ordered[k - 1], ordered[-k]


def _left(stage: StageSoFar, usual: Mapping[str, float], pace: float, frames: int) -> tuple[float, tuple[float, float]]:
    """Seconds that a stage will still take, and by what factors that may be wrong."""
    if stage.state == "running" and stage.seconds and stage.progress > 0.02:
        return stage.seconds * (1.0 - stage.progress) / stage.progress, USUAL_SPREAD
    if stage.stage in usual:
        return usual[stage.stage], USUAL_SPREAD
    return SECONDS_A_FRAME.get(stage.stage, OTHER_STAGE) * frames * pace, ROUGH_SPREAD


def _pace(stages: Sequence[StageSoFar], frames: int) -> float:
    """How many times as long this machine takes as the prior says, by the drive's stages that are done."""
    done = [stage for stage in stages if stage.state == "done" and stage.seconds and stage.stage in SECONDS_A_FRAME]
    expected = sum(SECONDS_A_FRAME[stage.stage] for stage in done) * frames
    return sum(stage.seconds or 0.0 for stage in done) / expected if expected > 0.0 else 1.0
