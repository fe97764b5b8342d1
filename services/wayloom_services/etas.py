"""Remaining time of a drive as the API tells it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

from wayloom.store.etas import told
from wayloom.store.etas.intervals import Learnt, estimate
from wayloom.store.etas.told import frames_of
from wayloom.store.held import Held
from wayloom.store.tables.drives import Drive
from wayloom_services.schemas.drives import EtaOut, StageOut

NOTHING_LEARNT: Final[Learnt] = MappingProxyType({})
PAST_S: Final = 5.0
"""What earlier drives took is read so often: it changes when a stage ends, and pages, metrics and streams ask all the time."""


@dataclass(frozen=True, slots=True)
class Past:
    """What earlier drives took, up to PAST_S seconds old: each stage, s; how intervals turned out, to learn from and to count."""

    usual: Held[dict[str, float]] = field(default_factory=lambda: Held(told.usual_seconds, PAST_S))
    learnt: Held[Learnt] = field(default_factory=lambda: Held(told.learnt, PAST_S))
    counts: Held[Sequence[tuple[str, int, int]]] = field(default_factory=lambda: Held(told.counts, PAST_S))
    calibration: Held[told.Calibration] = field(default_factory=lambda: Held(told.calibration, PAST_S))


def etas_of(
    drive: Drive, stages: Sequence[StageOut], usual: Mapping[str, float], learnt: Learnt
) -> tuple[float | None, EtaOut | None]:
    """Seconds as one number, None where a stage to come was never seen, and as an interval; None where nobody works on the drive.
    usual : s by stage, of those that were ever done"""
    at_work = drive.state in ("queued", "running", "stitching") or drive.coming is not None
    if not at_work or (drive.coming or {}).get("error"):
        return None, None
    found = estimate(stages, usual, frames_of(drive), learnt)
    if found is None:
        return 0.0, EtaOut(low_s=0.0, high_s=0.0, rough=False)
    return None if found.rough else found.expected_s, EtaOut(low_s=found.low_s, high_s=found.high_s, rough=found.rough)
