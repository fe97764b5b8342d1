"""How long a drive will still take, as the API tells it: the running stage by its own pace, the others as they usually took."""

import time

import pytest

from wayloom.store.drives import Received
from wayloom.store.tables.drives import Drive, Job
from wayloom_services.schemas.drives import DriveOut
from wayloom_services.views import drive_out


def drive(state: str = "running", placed: bool | None = None) -> Drive:
    return Drive(
        id="d" * 64, name="street", vehicle_id=None, map_id="city", manifest={}, file_count=1, byte_count=10, state=state,
        error=None, placed=placed, facts={}, track=None, stitch_job_id=None, created_at=1.0, uploaded_at=2.0, finished_at=None,
        images="kept",
    )  # fmt: skip


def job(stage: str, state: str, progress: float = 0.0, age_s: float | None = None) -> Job:
    started = None if age_s is None else time.time() - age_s
    return Job(
        drive_id="d" * 64, stage=stage, position=0, queue="q", state=state, attempt=1, progress=progress, message="", error=None,
        losses=[], created_at=1.0, started_at=started, finished_at=time.time() if state == "done" else None,
    )  # fmt: skip


def told(row: Drive, jobs: list[Job], usual: dict[str, float]) -> DriveOut:
    return drive_out(row, jobs, Received(1, 10), usual)


STAGES = [stage.stage for stage in told(drive(), [], {}).stages]
USUAL = {stage: 10.0 * (k + 1) for k, stage in enumerate(STAGES)}


def test_a_drive_that_waits_takes_as_long_as_all_its_stages_usually_took() -> None:
    assert told(drive("queued"), [], USUAL).eta_s == pytest.approx(sum(USUAL.values()))


def test_the_running_stage_counts_by_its_own_pace_and_stages_that_are_done_no_more() -> None:
    jobs = [job(STAGES[0], "done", 1.0, 50.0), job(STAGES[1], "running", 0.25, 30.0)]
    rest = sum(USUAL[stage] for stage in STAGES[2:])
    assert told(drive(), jobs, USUAL).eta_s == pytest.approx(rest + 30.0 * 0.75 / 0.25, abs=1.0)


def test_a_stage_that_has_hardly_begun_counts_as_long_as_it_usually_takes() -> None:
    jobs = [job(STAGES[0], "running", 0.01, 30.0)]
    assert told(drive(), jobs, USUAL).eta_s == pytest.approx(sum(USUAL.values()))


def test_nothing_is_promised_where_a_stage_to_come_was_never_seen() -> None:
    known = {stage: seconds for stage, seconds in USUAL.items() if stage != STAGES[-1]}
    assert told(drive(), [job(STAGES[0], "running", 0.5, 10.0)], known).eta_s is None


@pytest.mark.parametrize("state", ["uploading", "done", "failed", "removing"])
def test_a_drive_that_nobody_works_on_has_no_end(state: str) -> None:
    assert told(drive(state), [], USUAL).eta_s is None


def test_a_drive_without_a_place_on_earth_waits_for_no_map() -> None:
    placed = told(drive(placed=True), [], USUAL)
    unplaced = told(drive(placed=False), [], USUAL)
    assert len(unplaced.stages) < len(placed.stages)
    assert unplaced.eta_s == pytest.approx(sum(USUAL[stage.stage] for stage in unplaced.stages))


def test_the_first_drive_of_a_service_has_a_rough_interval_that_its_done_stages_scale() -> None:
    fresh = told(drive("queued"), [], {}).eta
    assert fresh is not None
    assert fresh.rough
    assert 0 < fresh.low_s < fresh.high_s
    row = drive("running")
    row.facts = {"log": {"frames": {"count": 1000}}}
    slow = told(row, [job(STAGES[0], "done", 1.0, 100.0)], {}).eta
    quick = told(row, [job(STAGES[0], "done", 1.0, 10.0)], {}).eta
    assert slow is not None
    assert quick is not None
    assert slow.low_s == pytest.approx(10.0 * quick.low_s, rel=0.05)


def test_the_plain_guess_is_not_corrected_by_history_as_the_interval_is() -> None:
    late = drive_out(drive("queued"), [], Received(1, 10), USUAL, {(STAGES[0], False): (3.0, 4.0)})
    assert late.eta is not None
    assert late.eta_s == pytest.approx(sum(USUAL.values()))
    assert late.eta_s < late.eta.low_s
    assert "may lie outside" in str(DriveOut.model_fields["eta_s"].description)


def test_the_interval_is_narrow_and_not_rough_where_every_stage_was_seen() -> None:
    known = told(drive("queued"), [], USUAL).eta
    assert known is not None
    assert not known.rough
    assert known.low_s < sum(USUAL.values()) < known.high_s
