"""`wayloom calibrate` as a user runs it, on evidence files."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from made_observations import LENS, made_drive

from wayloom.calibration.learn import learn_rig
from wayloom.calibration.report import facts, lines, warnings
from wayloom.calibration.rig_file import read_rig_file
from wayloom.geometry.lens import IDENTITY, PARAMETERS
from wayloom.odometry.rig.calibration_file import save_observations


def calibrate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "wayloom.cli.main", "calibrate", *(str(argument) for argument in arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Evidence of three drives: two in a folder, one where `wayloom process` leaves it."""
    root = tmp_path_factory.mktemp("drives")
    for seed in range(2):
        save_observations(made_drive(LENS, seed), root / "gathered" / f"drive-{seed}.npz")
    save_observations(made_drive(LENS, 2), root / "processed" / "stages" / "odometry" / "evidence.npz")
    return root


def test_a_rig_is_learnt_from_folders_of_evidence_and_what_process_left(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "RIG.toml"
    done = calibrate(folder / "gathered", folder / "processed", "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    rig = read_rig_file(out)
    assert rig.drives == ("drive 0", "drive 1", "drive 2")
    expected = learn_rig([made_drive(LENS, seed) for seed in range(3)]).rig
    assert rig.lens == expected.lens
    said = json.loads(done.stdout)
    assert set(said["right_lens"]) == set(PARAMETERS)
    assert "moves pixels of the right image by up to 7." in done.stderr
    assert "written: " in done.stderr


def test_a_known_rig_gets_better_with_one_more_drive(folder: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "one.toml", tmp_path / "two.toml"
    assert calibrate(folder / "gathered" / "drive-0.npz", "--out", first).returncode == 0
    done = calibrate(folder / "gathered", "--rig", first, "--out", second)
    assert done.returncode == 0
    assert "drive 0 is left out: it is learnt from already" in done.stderr
    rig = read_rig_file(second)
    assert rig.drives == ("drive 0", "drive 1")
    assert (rig.sigma <= read_rig_file(first).sigma).sum() >= 8


def test_bad_input_ends_in_one_line_and_status_2_and_writes_nothing(folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("format_version = 1\n")
    good = folder / "gathered" / "drive-0.npz"
    for arguments, says in (
        ((tmp_path / "nowhere",), "nowhere"),
        ((good, "--rig", broken), "right_lens"),
        ((good, "--rig", tmp_path / "missing.toml"), "no such file"),
    ):
        done = calibrate(*arguments, "--out", tmp_path / "RIG.toml")
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
        assert says in done.stderr
    assert not (tmp_path / "RIG.toml").exists()


def test_the_report_says_what_is_known_and_what_is_not() -> None:
    good, bad = learn_rig([made_drive(IDENTITY, 0)]), learn_rig([made_drive(LENS, 0)])
    assert warnings(good) == []
    assert "by up to 7." in warnings(bad)[0]
    assert any(line.strip().startswith("k1") and "±" in line for line in lines(bad))
    assert facts(bad)["used"][0]["name"] == "drive 0"
    json.dumps(facts(bad))


def test_a_drive_that_does_not_fit_is_named() -> None:
    found = learn_rig([made_drive(LENS, 0), made_drive(LENS, 1), made_drive(IDENTITY, 2, groups=4, outliers=0.9)])
    assert [warning for warning in warnings(found) if warning.startswith("drive 2 does not fit")]
