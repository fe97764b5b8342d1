"""Intervals of remaining time: learnt from earlier drives they hold for later ones, and how often they held is told."""

import math
import random

import pytest
from sqlalchemy import select, update

from wayloom.config.stages import drive_stages
from wayloom.store import drives, jobs
from wayloom.store.database import Database
from wayloom.store.etas import told
from wayloom.store.etas.intervals import LEAST, NOMINAL, USUAL_SPREAD, estimate, learn
from wayloom.store.etas.told import StageTime, calibration, counts, learnt, note_estimate, settle
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.tables.drives import Drive, DriveEstimate

STAGES = drive_stages()
DRAWS = {
    "as estimated, give or take": lambda dice: dice.lognormvariate(0.0, 0.2),
    "twice as long": lambda dice: dice.lognormvariate(math.log(2.0), 0.1),
    "mostly quick, at times stuck": lambda dice: dice.uniform(0.9, 1.1) if dice.random() < 0.85 else dice.uniform(5.0, 50.0),
}


def new_drive(database: Database, name: str = "a") -> tuple[str, int]:
    """A drive that has arrived, and its first job."""
    with database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive, _ = drives.register(session, manifest, "city")
        message = drives.mark_complete(session, drive.id, "log/a")
        assert message is not None
        return drive.id, message.job_id


def judged(database: Database, ratios: list[float], stage: str = "odometry", rough: bool = False) -> None:
    """A history in which the truth was so many times the estimate, which was told as 0.7 to 1.5 of it."""
    with database.write() as session:
        for ratio in ratios:
            told_s = {"expected_s": 100.0, "low_s": 70.0, "high_s": 150.0}
            session.add(DriveEstimate(at=1.0, stage=stage, rough=rough, truth_s=100.0 * ratio, **told_s))


def rows(database: Database) -> list[DriveEstimate]:
    with database.read() as session:
        return [*session.scalars(select(DriveEstimate).order_by(DriveEstimate.id))]


@pytest.mark.parametrize("kind", DRAWS)
@pytest.mark.parametrize("seed", [1, 2])
def test_factors_learnt_on_one_half_of_the_drives_hold_the_nominal_share_of_the_other(kind: str, seed: int) -> None:
    dice = random.Random(seed)
    ratios = [DRAWS[kind](dice) for _ in range(2000)]
    factors = learn(ratios[:1000])
    assert factors is not None
    held = sum(factors[0] <= ratio <= factors[1] for ratio in ratios[1000:]) / 1000
    noise = math.sqrt(2.0 * NOMINAL * (1.0 - NOMINAL) / 1000)  # binomial, of either half
    assert abs(held - NOMINAL) < 3.0 * noise


@pytest.mark.parametrize("kind", DRAWS)
def test_factors_of_few_drives_hold_the_nominal_share_on_the_average(kind: str) -> None:
    dice = random.Random(3)
    held, trials = 0, 2000
    for _ in range(trials):
        factors = learn([DRAWS[kind](dice) for _ in range(LEAST)])
        assert factors is not None
        held += factors[0] <= DRAWS[kind](dice) <= factors[1]
    noise = math.sqrt(NOMINAL * (1.0 - NOMINAL) / trials)
    assert NOMINAL - 3.0 * noise < held / trials < NOMINAL + 2.0 / (LEAST + 1) + 3.0 * noise


def test_nothing_is_learnt_of_a_handful_of_drives() -> None:
    assert learn([1.0] * (LEAST - 1)) is None
    assert learn([1.0] * LEAST) == (1.0, 1.0)


def test_the_measured_share_is_told_over_all_and_by_the_stage_at_whose_begin_the_interval_was_told(database: Database) -> None:
    judged(database, [1.0, 1.4, 1.6], "odometry")
    judged(database, [0.6, 0.7, 0.2, 2.0], "ground")
    with database.write() as session:
        session.add(DriveEstimate(at=1.0, stage="ground", expected_s=1.0, low_s=0.0, high_s=9.0, rough=False))
        assert sorted(counts(session)) == [("ground", 4, 1), ("odometry", 3, 2)]
        assert calibration(session) == told.Calibration(7, 3)
        assert calibration(session, newest=4) == told.Calibration(4, 1)


def test_an_interval_is_widened_or_narrowed_by_the_history_of_its_stage(database: Database) -> None:
    judged(database, [3.0 + 0.01 * k for k in range(told.NEWEST)], "odometry")
    judged(database, [1.0] * (LEAST - 1), "ground")
    stages = [StageTime(name, "waiting", 0.0, None) for name in STAGES]
    usual = dict.fromkeys(STAGES, 10.0)
    with database.read() as session:
        known = learnt(session)
        assert learnt(session, "odometry") == known
        assert learnt(session, "ground") == {}
    at = STAGES.index("odometry")
    found = estimate(stages[at:], usual, 100, known)
    assert found is not None
    assert found.low_s / found.expected_s == pytest.approx(3.0 + 0.01 * 9)
    assert found.high_s / found.expected_s == pytest.approx(3.0 + 0.01 * 90)
    before = estimate(stages, usual, 100, known)
    assert before is not None
    assert (before.low_s, before.high_s) == pytest.approx([factor * before.expected_s for factor in USUAL_SPREAD])


def test_only_the_newest_drives_are_learnt_from(database: Database) -> None:
    judged(database, [9.0] * 50)
    judged(database, [1.0] * told.NEWEST)
    with database.read() as session:
        assert learnt(session) == {("odometry", False): (1.0, 1.0)}


def test_an_estimate_is_noted_as_a_stage_begins_and_judged_when_the_drive_is_finished(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    held = jobs.claim(database, job_id, "elsewhere|1|1", 60.0)
    assert held is not None
    (row,) = rows(database)
    assert (row.stage, row.rough, row.truth_s) == (STAGES[0], True, None)
    assert 0.0 < row.low_s < row.expected_s < row.high_s
    with database.write() as session:
        jobs.release(session, held)
    held = jobs.claim(database, job_id, "elsewhere|1|1", 60.0)
    assert held is not None
    assert len(rows(database)) == 1, "a second attempt is the same stage: what was told first counts"
    with database.write() as session:
        following = jobs.finish(session, held, "key")
        assert following is not None
    assert jobs.claim(database, following.job_id, "elsewhere|1|1", 60.0) is not None
    assert [row.stage for row in rows(database)] == [*STAGES[:2]]
    with database.write() as session:
        session.execute(update(Drive).where(Drive.id == drive_id).values(state="done", finished_at=row.at + 40.0))
        settle(session, Drive.id == drive_id)
    assert rows(database)[0].truth_s == pytest.approx(40.0)
    assert all(one.truth_s is not None for one in rows(database))


def test_estimates_of_a_drive_that_fails_are_forgotten(database: Database) -> None:
    _, job_id = new_drive(database)
    held = jobs.claim(database, job_id, "elsewhere|1|1", 60.0)
    assert held is not None
    with database.write() as session:
        jobs.fail(session, held, "no luck", final=True)
    assert rows(database) == []


def test_an_end_before_the_estimate_by_a_clock_that_went_back_is_not_judged(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    assert jobs.claim(database, job_id, "elsewhere|1|1", 60.0) is not None
    with database.write() as session:
        session.execute(update(Drive).where(Drive.id == drive_id).values(state="done", finished_at=5.0))
        settle(session, Drive.id == drive_id)
    assert rows(database) == []


def test_judged_estimates_outlive_their_drive_without_its_name(database: Database) -> None:
    drive_id, _ = new_drive(database)
    with database.write() as session:
        told_s = {"expected_s": 100.0, "low_s": 70.0, "high_s": 150.0}
        session.add(DriveEstimate(drive_id=drive_id, at=1.0, stage="ground", rough=False, truth_s=100.0, **told_s))
        drives.delete_rows(session, drive_id)
    (row,) = rows(database)
    assert (row.drive_id, row.truth_s) == (None, 100.0)


def test_open_estimates_go_when_their_drive_is_to_be_removed(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    assert jobs.claim(database, job_id, "elsewhere|1|1", 60.0) is not None
    assert len(rows(database)) == 1
    with database.write() as session:
        drives.request_removal(session, drive_id)
    assert rows(database) == []


def test_a_drive_that_is_processed_anew_notes_nothing(database: Database) -> None:
    drive_id, _ = new_drive(database)
    with database.write() as session:
        session.get_one(Drive, drive_id).coming = {"asked": {}, "since": 1.0}
        session.flush()
        note_estimate(session, drive_id, STAGES[0])
    assert rows(database) == []
