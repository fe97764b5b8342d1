"""Intervals that were told of drives, kept once a stage, and judged when the drive is finished."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import ColumnElement, and_, delete, func, insert, null, select, update
from sqlalchemy.orm import Session

from wayloom.config.stages import drive_stages, map_stages
from wayloom.store.database import now_s
from wayloom.store.etas.intervals import Estimate, Learnt, estimate, learn
from wayloom.store.tables.drives import Drive, DriveEstimate, Job

NEWEST: Final = 100
"""Judged estimates of a stage that the next ones are learnt from: what is older tells of another machine or version."""
JUDGED: Final = 1000
"""Newest judged estimates that the measured share is of."""
FINISHED: Final = ("done", "held", "quarantined")


@dataclass(frozen=True, slots=True)
class StageTime:
    """A stage by its row, `wayloom.store.etas.intervals.StageSoFar`."""

    stage: str
    state: str
    progress: float
    seconds: float | None


@dataclass(frozen=True, slots=True)
class Calibration:
    """Of the newest `judged` estimates, how many had the truth `within`."""

    judged: int
    within: int


def usual_seconds(session: Session, newest_jobs: int = 200) -> dict[str, float]:
    """For each stage, the mean of how long it took lately."""
    lately = (
        select(Job.stage, Job.started_at, Job.finished_at)
        .where(Job.state == "done", Job.part == 0)
        .order_by(Job.id.desc())
        .limit(newest_jobs)
    )
    took: dict[str, list[float]] = {}
    for stage, started, finished in session.execute(lately):
        if started is not None and finished is not None:
            took.setdefault(stage, []).append(finished - started)
    return {stage: sum(seconds) / len(seconds) for stage, seconds in took.items()}


def frames_of(drive: Drive) -> int:
    """Of its log where that was read; before, every other file is taken for one."""
    log = (drive.facts or {}).get("log") or {}
    counted = (log.get("frames") or {}).get("count")
    return int(counted or max(1, drive.file_count // 2))


def learnt(session: Session, stage: str | None = None) -> Learnt:
    """Factors of the intervals to be told now, by stage and roughness, where enough were judged. stage : of this one alone"""
    stages = (*drive_stages(), *map_stages())
    query = select(DriveEstimate.stage, DriveEstimate.rough, DriveEstimate.truth_s / DriveEstimate.expected_s)
    query = query.where(DriveEstimate.truth_s.is_not(None)).order_by(DriveEstimate.id.desc())
    query = query.limit(NEWEST * len(stages)) if stage is None else query.where(DriveEstimate.stage == stage).limit(NEWEST)
    ratios: dict[tuple[str, bool], list[float]] = {}
    for name, rough, ratio in session.execute(query):
        if ratio is not None and len(ratios.setdefault((name, rough), [])) < NEWEST:
            ratios[name, rough].append(ratio)
    found = {key: learn(values) for key, values in ratios.items()}
    return {key: factors for key, factors in found.items() if factors is not None}


def note_estimate(session: Session, drive_id: str, stage: str) -> None:
    """Keep the interval that is told as this stage of the drive begins; once a stage. Not of a drive that is processed anew, most
    of whose stages find their results made."""
    drive = session.get_one(Drive, drive_id)
    open_one = select(DriveEstimate.id).where(
        DriveEstimate.drive_id == drive_id, DriveEstimate.stage == stage, DriveEstimate.truth_s.is_(None)
    )
    if drive.coming is not None or session.scalars(open_one).first() is not None:
        return
    told = estimate(_stages(session, drive_id, stage), usual_seconds(session), frames_of(drive), learnt(session, stage))
    if told is not None and told.expected_s > 0.0:
        _keep(session, drive_id, told)


def settle(session: Session, which: ColumnElement[bool]) -> None:
    """Judge the estimates of drives that are finished; forget those of drives that failed, as nobody knows when they are tried
    again. which : a condition on drives, all of whose estimates this transaction may lock
    """
    session.flush()
    finished = select(Drive.id).where(which, Drive.state.in_(FINISHED), Drive.finished_at.is_not(None), Drive.coming.is_(null()))
    ended = select(Drive.finished_at).where(Drive.id == DriveEstimate.drive_id).scalar_subquery()
    is_open = DriveEstimate.truth_s.is_(None)
    judged = update(DriveEstimate).where(is_open, DriveEstimate.drive_id.in_(finished), ended >= DriveEstimate.at)
    session.execute(judged.values(truth_s=ended - DriveEstimate.at), execution_options={"synchronize_session": False})
    failed = select(Drive.id).where(which, Drive.state.in_((*FINISHED, "failed")))
    session.execute(delete(DriveEstimate).where(is_open, DriveEstimate.drive_id.in_(failed)))


def forget_open(session: Session, drive_id: str) -> None:
    """Forget the estimates of a drive that are not judged: it is to be removed, and nobody will know how long it took."""
    session.execute(delete(DriveEstimate).where(DriveEstimate.drive_id == drive_id, DriveEstimate.truth_s.is_(None)))


def calibration(session: Session, newest: int = JUDGED) -> Calibration:
    """Of the newest judged estimates."""
    query = select(_within()).where(DriveEstimate.truth_s.is_not(None)).order_by(DriveEstimate.id.desc()).limit(newest)
    found = session.scalars(query).all()
    return Calibration(len(found), sum(found))


def counts(session: Session) -> Sequence[tuple[str, int, int]]:
    """(stage at whose begin they were told, judged estimates, those with the truth within), ever. Never fewer than before: the
    estimates of a removed drive stay, without its name."""
    within = func.count().filter(_within())
    query = select(DriveEstimate.stage, func.count(), within).where(DriveEstimate.truth_s.is_not(None))
    return [(stage, judged, held) for stage, judged, held in session.execute(query.group_by(DriveEstimate.stage))]


def _within() -> ColumnElement[bool]:
    return and_(DriveEstimate.low_s <= DriveEstimate.truth_s, DriveEstimate.truth_s <= DriveEstimate.high_s)


def _stages(session: Session, drive_id: str, begun: str) -> list[StageTime]:
    """Every stage that the drive will have, of which `begun` has only just begun."""
    rows = {job.stage: job for job in session.scalars(select(Job).where(Job.drive_id == drive_id, Job.part == 0))}
    return [_stage_time(name, None if name == begun else rows.get(name)) for name in (*drive_stages(), *map_stages())]


def _stage_time(name: str, job: Job | None) -> StageTime:
    if job is None or job.state != "done":
        return StageTime(name, "waiting", 0.0, None)
    took = None if job.started_at is None or job.finished_at is None else max(0.0, job.finished_at - job.started_at)
    return StageTime(name, "done", 1.0, took)


def _keep(session: Session, drive_id: str, told: Estimate) -> None:
    values = {"stage": told.stage, "expected_s": told.expected_s, "low_s": told.low_s, "high_s": told.high_s, "rough": told.rough}
    session.execute(insert(DriveEstimate).values(drive_id=drive_id, at=now_s(session), **values))
