"""The receiver's clock in the workers' memory: drives with turns teach it, straight ones gain, a change is noticed."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from wayloom.calibration.rig_file import read_rig_file
from wayloom.evaluation.gnss_drives import Receiver, city_way, made_drive, straight_way
from wayloom.georeference.alignment import georeference
from wayloom.georeference.files import GEOREFERENCE_FILE, save_georeference
from wayloom.georeference.types import GeoReference
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, save_odometry
from wayloom.store import rigs
from wayloom_workers import rig_memory
from wayloom_workers.stage_hooks import WorkerContext
from workers.test_rig_memory import KEY, made_context, tracked


@pytest.fixture
def context(tmp_path: Path) -> Iterator[WorkerContext]:
    yield from made_context(tmp_path / "data")


def placed(context: WorkerContext, number: int, turns: bool, late_s: float) -> GeoReference:
    """Drive `number` as the workers place it with the rig's file, and what it tells the rig."""
    attempt, log = tracked(context, number)
    file = rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    made = made_drive(city_way(60.0) if turns else straight_way(30.0), Receiver(late_s=late_s), number)
    known = () if file is None else read_rig_file(file).receivers
    geo = georeference(made.log, made.odometry, rig_receiver=known)
    (attempt.inputs_dir / "odometry").mkdir()
    save_odometry(made.odometry, attempt.inputs_dir / "odometry" / ODOMETRY_FILE)
    save_georeference(geo, attempt.out_dir / GEOREFERENCE_FILE)
    rig_memory.remember_gnss(attempt)
    return geo


def test_a_straight_drive_is_grade_a_after_one_with_turns_and_a_changed_clock_is_noticed(context: WorkerContext) -> None:
    assert placed(context, 0, turns=False, late_s=0.03).report["grade"] == "C"
    assert placed(context, 1, turns=True, late_s=0.03).report["receiver_known_by"] == []
    straight = placed(context, 2, turns=False, late_s=0.03).report
    assert (straight["grade"], straight["receiver_known_by"]) == ("A", ["rig"])
    assert abs(straight["time_offset_s"] - 0.03) < 3.0 * straight["sigma_time_offset_s"]
    changed = placed(context, 3, turns=True, late_s=0.09).report
    assert any("the rig's earlier drives told" in message for message in changed["messages"])
    assert changed["time_offset_s"] == pytest.approx(0.09, abs=0.01)
    with context.database.read() as session:
        newest = rigs.version(session, KEY)
    assert newest.reason == "the GNSS receiver was changed"
    assert [len(epoch["drives"]) for epoch in newest.facts["receiver"]] == [1, 1]
    after = placed(context, 4, turns=False, late_s=0.09).report
    assert after["grade"] == "A"
    assert abs(after["time_offset_s"] - 0.09) < 3.0 * after["sigma_time_offset_s"]
