"""Rig memory of the workers: the set of evidence decides, a knock is noticed, a removed drive is forgotten."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.made_observations import LENS, RIG, made_drive
from wayloom.calibration.receiver import learnt_receiver
from wayloom.calibration.rig_file import read_rig_file
from wayloom.config.progress import silent
from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import RightLens
from wayloom.odometry.rig.calibration_file import save_observations
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store import drives, rigs
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom_workers import rig_memory
from wayloom_workers.__main__ import make_context
from wayloom_workers.stage_hooks import RepeatStageError, StageAttempt, WorkerContext

KNOCKED = replace(LENS, pitch_rad=LENS.pitch_rad + 2e-3, yaw_rad=LENS.yaw_rad - 3e-3)
KEY = str(rigs.rig_key("taxi", "roof"))
DAY_NS = 86_400 * 10**9
NOON_NS = 20_000 * DAY_NS


@dataclass
class MadeLog:
    """As much of a log as the memory looks at."""

    t_ns: NDArray[np.int64]
    rig: StereoRig = RIG
    rig_id: str | None = "roof"
    vehicle_id: str | None = "taxi"


@pytest.fixture
def context(tmp_path: Path) -> Iterator[WorkerContext]:
    yield from made_context(tmp_path / "data")


def made_context(folder: Path, **settings: object) -> Iterator[WorkerContext]:
    made = make_context(WayloomSettings(data_dir=folder, **settings))  # type: ignore[arg-type]
    upgrade(made.database)
    yield made
    made.database.close()


def tracked(context: WorkerContext, number: int, lens: RightLens = LENS) -> tuple[StageAttempt, MadeLog]:
    """Drive `number`, recorded on that day, as it is when its odometry is done."""
    with context.database.write() as session:
        manifest = Manifest(name=f"{number}", vehicle_id="taxi", files=(ManifestFile(path="log/0", size=number, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
    folder = context.folders.drive(drive_id) / "attempts" / "odometry"
    (folder / "inputs").mkdir(parents=True)
    (folder / "out").mkdir()
    observations = made_drive(lens, number, groups=12, points=40, group_px=0.05, rig_id="roof")
    save_observations(observations, folder / "out" / rig_memory.EVIDENCE_FILE)
    claim = Claim(1, 1, "odometry", 1, drive_id, None, {})
    attempt = StageAttempt(context, claim, None, None, folder / "inputs", {}, folder / "out", silent)
    return attempt, MadeLog(np.array([NOON_NS + number * DAY_NS]))


def drive(context: WorkerContext, number: int, lens: RightLens = LENS) -> StageAttempt:
    """Track drive `number`, again where it must be."""
    attempt, log = tracked(context, number, lens)
    rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    try:
        rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    except RepeatStageError:
        rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
        rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    return attempt


def said(attempt: StageAttempt) -> dict[str, object]:
    with attempt.context.database.read() as session:
        found: dict[str, object] = drives.get(session, str(attempt.claim.drive_id)).facts["rig"]
        return found


def newest(context: WorkerContext) -> tuple[int, str]:
    with context.database.read() as session:
        found = rigs.version(session, KEY)
        return found.version, found.digest


def test_each_drive_uses_what_the_ones_before_it_taught_and_teaches_the_next(context: WorkerContext) -> None:
    attempts = [drive(context, number) for number in range(3)]
    assert [said(attempt)["version"] for attempt in attempts] == [None, 1, 2]
    assert newest(context)[0] == 3
    file = attempts[1].inputs_dir.parent / rig_memory.RIG_FILE
    with context.database.read() as session:
        assert context.blobs.get(rigs.version(session, KEY, 1).digest) == file.read_bytes()
        assert rigs.version(session, KEY, 3).drives == sorted(str(attempt.claim.drive_id) for attempt in attempts)


def test_the_order_of_arrival_changes_no_byte_of_the_file(context: WorkerContext, tmp_path: Path) -> None:
    for number in (0, 1, 2):
        drive(context, number)
    for other in made_context(tmp_path / "other"):
        for number in (2, 0, 1):
            drive(other, number)
        assert newest(other) == newest(context)


def test_two_workers_at_once_leave_what_one_after_the_other_leaves(context: WorkerContext, tmp_path: Path) -> None:
    prepared = [tracked(context, number) for number in (0, 1, 2)]
    threads = [threading.Thread(target=rig_memory.remember, args=one) for one in prepared]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for other in made_context(tmp_path / "other"):
        for number in (0, 1, 2):
            drive(other, number)
        assert newest(other)[1] == newest(context)[1]


def test_a_stage_that_is_repeated_changes_nothing_and_goes_on_with_the_same_file(context: WorkerContext) -> None:
    drive(context, 0)
    attempt, log = tracked(context, 1)
    first = rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    assert first is not None
    content = first.read_bytes()
    rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    before = newest(context)
    again = rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    assert again is not None
    assert again.read_bytes() == content
    rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    assert newest(context) == before


def test_a_knock_is_noticed_the_drive_is_tracked_again_and_old_versions_stay(context: WorkerContext) -> None:
    for number in (0, 1):
        drive(context, number)
    attempt, log = tracked(context, 2, KNOCKED)
    rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    assert said(attempt)["version"] == 2
    with pytest.raises(RepeatStageError, match="knocked"):
        rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    about = said(attempt)
    assert (about["version"], about["knocked"], about["instead_of"]) == (3, True, 2)
    rig_memory.rig_file_for(attempt, log)  # type: ignore[arg-type]
    rig_memory.remember(attempt, log)  # type: ignore[arg-type]
    after = drive(context, 3, KNOCKED)
    assert said(after)["version"] == 3
    with context.database.read() as session:
        found = rigs.versions(session, KEY)
        assert [version.version for version in found] == [4, 3, 2, 1]
        assert [version.reason for version in found] == [
            "evidence changed",
            "the rig was knocked",
            "evidence changed",
            "first drive",
        ]
        rows = rigs.evidence_of(session, KEY)
        assert [row.from_ns == rows[2].from_ns for row in rows] == [False, False, True, True]
        assert (rows[2].chi_square or 0.0) > 1000


def test_a_drive_of_before_the_knock_that_comes_late_gets_the_old_file(context: WorkerContext) -> None:
    for number, lens in ((0, LENS), (5, KNOCKED)):
        drive(context, number, lens)
    late = drive(context, 1)
    assert said(late)["version"] == 1
    with context.database.read() as session:
        assert rigs.version(session, KEY).from_ns == NOON_NS


def test_a_removed_drive_is_forgotten_as_if_it_had_never_been(context: WorkerContext, tmp_path: Path) -> None:
    attempts = [drive(context, number) for number in (0, 1, 2)]
    with context.database.write() as session:
        drives.request_removal(session, str(attempts[1].claim.drive_id))
    rig_memory.forget(attempts[1])
    with context.database.write() as session:
        drives.delete_rows(session, str(attempts[1].claim.drive_id))
    for other in made_context(tmp_path / "other"):
        for number in (0, 2):
            drive(other, number)
        assert newest(other)[1] == newest(context)[1]


def test_the_last_drive_that_goes_leaves_a_rig_of_which_nothing_is_known(context: WorkerContext) -> None:
    only = drive(context, 0)
    with context.database.write() as session:
        drives.request_removal(session, str(only.claim.drive_id))
    rig_memory.forget(only)
    with context.database.read() as session:
        assert rigs.version_for(session, KEY, NOON_NS) is None


def test_a_log_that_names_neither_vehicle_nor_rig_is_not_remembered(context: WorkerContext) -> None:
    attempt, log = tracked(context, 0)
    with context.database.write() as session:
        drives.get(session, str(attempt.claim.drive_id)).vehicle_id = None
    nameless = replace(log, rig_id=None, vehicle_id=None)
    assert rig_memory.rig_file_for(attempt, nameless) is None  # type: ignore[arg-type]
    rig_memory.remember(attempt, nameless)  # type: ignore[arg-type]
    with context.database.read() as session:
        assert list(rigs.all_rigs(session)) == []


def test_a_rig_of_the_settings_has_the_last_word_and_memory_can_be_turned_off(tmp_path: Path) -> None:
    for context in made_context(tmp_path / "a"):
        first = drive(context, 0)
        with context.database.read() as session:
            own = context.blobs.get(rigs.version(session, KEY).digest)
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "roof.toml").write_bytes(own)
    for given in made_context(tmp_path / "b", rig=tmp_path / "rigs"):
        attempt, log = tracked(given, 1)
        assert rig_memory.rig_file_for(attempt, log) == tmp_path / "rigs"  # type: ignore[arg-type]
    for off in made_context(tmp_path / "c", rig_memory=False):
        assert rig_memory.rig_file_for(*tracked(off, 1)) is None  # type: ignore[arg-type]
        drive(off, 2)
        with off.database.read() as session:
            assert rigs.evidence_of_drive(session, str(first.claim.drive_id)) is None


def test_what_gnss_says_of_a_drives_length_makes_a_version_with_a_baseline(context: WorkerContext) -> None:
    drive_id = str(drive(context, 0).claim.drive_id)
    scale = {"ratio": 1.004, "sigma": 3e-4, "by_lens": [0.0] * 10, "own_sigma": 0.0, "lens": [0.0] * 10, "baseline_ratio": 1.0}
    rig_memory.learn_anew(context.database, context.blobs, KEY, by_gnss={drive_id: rigs.ByGnss(scale)})
    with context.database.read() as session:
        ratio = rigs.version(session, KEY).facts["baseline_ratio"]
        assert rigs.evidence_of(session, KEY)[0].scale == scale
    assert ratio["value"] == pytest.approx(1.004, abs=2e-4)
    assert ratio["sigma"] < 6e-4
    assert ratio["drives_with_gnss"] == 1


def told_of_receiver(context: WorkerContext, number: int, late_s: float) -> str:
    """A drive that turns corners with RTK, whose receiver's stamps are late by so much: its id."""
    drive_id = str(drive(context, number).claim.drive_id)
    information = np.diag([4e5, 1e3, 0.0, 1e3])
    told = {"information": information.tolist(), "pull": (information @ [late_s, 0.1, 0.0, -1.0]).tolist()}
    rig_memory.learn_anew(context.database, context.blobs, KEY, by_gnss={drive_id: rigs.ByGnss(None, told)})
    return drive_id


def test_what_drives_tell_of_the_gnss_clock_is_in_the_file_of_the_next(context: WorkerContext) -> None:
    ids = [told_of_receiver(context, number, 0.02) for number in (0, 1)]
    file = rig_memory.rig_file_for(*tracked(context, 2))  # type: ignore[arg-type]
    assert file is not None
    receivers = read_rig_file(file).receivers
    assert [one.drive_id for one in receivers] == ids
    learnt = learnt_receiver(receivers)
    assert learnt is not None
    assert learnt.mean[0] == pytest.approx(0.02, abs=1e-4)
    assert np.sqrt(learnt.covariance[0, 0]) < 0.005


def test_what_fixes_say_of_a_rigs_only_drive_is_no_knock(context: WorkerContext) -> None:
    told_of_receiver(context, 0, 0.02)
    with context.database.read() as session:
        assert [version.reason for version in rigs.versions(session, KEY)] == ["evidence changed", "first drive"]


def test_a_receiver_that_was_changed_begins_an_epoch_and_leaves_the_lens_alone(context: WorkerContext) -> None:
    for number, late_s in enumerate((0.0, 0.0, 0.09)):
        told_of_receiver(context, number, late_s)
    with context.database.read() as session:
        found = rigs.version(session, KEY)
        evidence = rigs.evidence_of(session, KEY)
    assert found.reason == "the GNSS receiver was changed"
    assert len({row.from_ns for row in evidence}) == 1
    before, after = found.facts["receiver"]
    assert (len(before["drives"]), before["chi_square"], len(after["drives"])) == (2, None, 1)
    assert after["time_offset_s"] == pytest.approx(0.09, abs=1e-3)


def test_a_removed_drive_is_forgotten_by_the_receiver_too(context: WorkerContext) -> None:
    attempts = [told_of_receiver(context, number, late_s) for number, late_s in enumerate((0.0, 0.09))]
    with context.database.write() as session:
        drives.get(session, attempts[1]).state = "removing"
    rig_memory.learn_anew(context.database, context.blobs, KEY)
    with context.database.read() as session:
        assert [epoch["drives"] for epoch in rigs.version(session, KEY).facts["receiver"]] == [attempts[:1]]
