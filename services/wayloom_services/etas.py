"""Remaining time of a drive as an interval: by this service's own history, and where that is thin by a prior, which is said."""

from collections.abc import Mapping, Sequence
from typing import Final

from wayloom.store.tables.drives import Drive
from wayloom_services.schemas.drives import EtaOut, StageOut

SECONDS_A_FRAME: Final[Mapping[str, float]] = {
    "ingest": 0.01, "odometry": 0.07, "segmentation": 0.06, "labelling": 0.01, "places": 0.02, "looks": 0.09, "loops": 0.001,
    "georeference": 0.02, "submaps": 0.003, "ground": 0.11, "objects": 0.05, "stitch": 0.4, "publish": 0.01,
}  # fmt: skip
"""Prior of a stage that this service has never run: `python benchmarks/eta_prior.py` prints the shares of a demo's drives. Only
their proportions matter once a stage of the drive is done: how long that took tells how fast this machine is."""
OTHER_STAGE: Final = 0.02
USUAL_SPREAD: Final = (0.7, 1.5)
ROUGH_SPREAD: Final = (0.4, 2.5)


def eta_of(drive: Drive, stages: Sequence[StageOut], usual: Mapping[str, float]) -> EtaOut | None:
    """From what is left of each stage; None where nobody works on the drive. usual : s by stage, of those that were ever done."""
    at_work = drive.state in ("queued", "running", "stitching") or drive.coming is not None
    if not at_work or (drive.coming or {}).get("error"):
        return None
    low = high = 0.0
    rough = False
    pace = _pace(drive, stages)
    for stage in stages:
        if stage.state == "done":
            continue
        seconds, spread = _left(stage, usual, pace, _frames(drive))
        rough |= spread == ROUGH_SPREAD
        low, high = low + spread[0] * seconds, high + spread[1] * seconds
    return EtaOut(low_s=low, high_s=high, rough=rough)


def _left(stage: StageOut, usual: Mapping[str, float], pace: float, frames: int) -> tuple[float, tuple[float, float]]:
    """Seconds that a stage will still take, and by what factors that may be wrong."""
    if stage.state == "running" and stage.seconds and stage.progress > 0.02:
        return stage.seconds * (1.0 - stage.progress) / stage.progress, USUAL_SPREAD
    if stage.stage in usual:
        return usual[stage.stage], USUAL_SPREAD
    return SECONDS_A_FRAME.get(stage.stage, OTHER_STAGE) * frames * pace, ROUGH_SPREAD


def _pace(drive: Drive, stages: Sequence[StageOut]) -> float:
    """How many times as long this machine takes as the prior says, by the drive's stages that are done."""
    done = [stage for stage in stages if stage.state == "done" and stage.seconds and stage.stage in SECONDS_A_FRAME]
    expected = sum(SECONDS_A_FRAME[stage.stage] for stage in done) * _frames(drive)
    return sum(stage.seconds or 0.0 for stage in done) / expected if expected > 0.0 else 1.0


def _frames(drive: Drive) -> int:
    """Of its log where that was read; before, every other file is taken for one."""
    log = (drive.facts or {}).get("log") or {}
    counted = (log.get("frames") or {}).get("count")
    return int(counted or max(1, drive.file_count // 2))
