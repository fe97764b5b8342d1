"""Remaining time of a drive as the API tells it."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

from wayloom.store.etas.intervals import Learnt, estimate
from wayloom.store.etas.told import frames_of
from wayloom.store.tables.drives import Drive
from wayloom_services.schemas.drives import EtaOut, StageOut

NOTHING_LEARNT: Final[Learnt] = MappingProxyType({})


def eta_of(drive: Drive, stages: Sequence[StageOut], usual: Mapping[str, float], learnt: Learnt) -> EtaOut | None:
    """From what is left of each stage; None where nobody works on the drive. usual : s by stage, of those that were ever done."""
    at_work = drive.state in ("queued", "running", "stitching") or drive.coming is not None
    if not at_work or (drive.coming or {}).get("error"):
        return None
    found = estimate(stages, usual, frames_of(drive), learnt)
    low, high, rough = (0.0, 0.0, False) if found is None else (found.low_s, found.high_s, found.rough)
    return EtaOut(low_s=low, high_s=high, rough=rough)
