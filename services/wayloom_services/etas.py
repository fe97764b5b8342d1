"""Remaining time of a drive as the API tells it."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

from wayloom.store.etas.intervals import Learnt, estimate
from wayloom.store.etas.told import frames_of
from wayloom.store.tables.drives import Drive
from wayloom_services.schemas.drives import EtaOut, StageOut

NOTHING_LEARNT: Final[Learnt] = MappingProxyType({})


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
