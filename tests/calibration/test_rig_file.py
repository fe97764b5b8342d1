import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wayloom.calibration.learn import learn_rig
from wayloom.calibration.receiver import ReceiverEvidence
from wayloom.calibration.rig_file import RigFile, differences, read_rig_file, text_of, write_rig_file
from wayloom.calibration.score_moments import SIZE, ScoreMoments
from wayloom.errors import CalibrationError
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import PARAMETERS, RightLens

RIG = StereoRig(PinholeCamera(718.856, 717.1, 607.1928, 185.2157, 1241, 376), (-0.5372, 0.001, -0.0002))
LENS = RightLens(1e-3, -2e-3, 1.5e-3, 3e-3, -4e-3, 1.002, -0.7, 0.01, -1e-3, 2e-3)


def made() -> RigFile:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(11, 11))
    determined = np.array([True] * 7 + [False, True, True])
    information, pull = root @ root.T, rng.normal(size=11)
    y = rng.normal(size=(30, SIZE))
    scores = ScoreMoments(y.T @ y, -1.5e-6, 14.5)
    return RigFile(
        "car-7", RIG, ('a"b', "straße\n2"), LENS, rng.uniform(0, 1e-3, 10), determined, information, pull, scores, 321, 0.11
    )


def test_a_rig_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_rig_file(made(), tmp_path / "RIG.toml")
    back = read_rig_file(tmp_path / "RIG.toml")
    assert (back.rig_id, back.rig, back.drives, back.lens, back.matches, back.noise_px) == (
        "car-7", RIG, ("a\"b", "straße\n2"), LENS, 321, 0.11,
    )  # fmt: skip
    for name in ("sigma", "determined", "information", "pull"):
        np.testing.assert_array_equal(getattr(back, name), getattr(made(), name))
    assert back.scores is not None
    np.testing.assert_array_equal(back.scores.moments, made().scores.moments)
    assert (back.scores.region_excess_px2, back.scores.region_freedom) == (-1.5e-6, 14.5)


def test_a_rig_without_a_name_stays_nameless(tmp_path: Path) -> None:
    nameless = RigFile(None, RIG, (), RightLens(), np.zeros(10), np.zeros(10, bool))
    write_rig_file(nameless, tmp_path / "RIG.toml")
    assert read_rig_file(tmp_path / "RIG.toml").rig_id is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("format_version = 2", "format_version = 3", "format_version 3"),
        ("k1 = 0.01", "k1 = nan", "right_lens.k1"),
        ("k1 = 0.01", "k1 = 7.0", "right_lens.k1: is impossible"),
        ("k1 = 0.01", "k3 = 0.01", "right_lens.k1: is missing"),
        ("k1 = false", "k1 = 0", "right_lens.determined.k1"),
        ("[camera]", "[lens]", "camera.fx: is missing"),
        ("t_right_left_m = [-", "t_right_left_m = [", "baseline"),
        ("drives = [", "drives = [3, ", "drives"),
        ("pull = [", "pull = [1.0, ", "normal_equations.pull"),
        ("information = [", "information = [[1.0], ", "normal_equations.information"),
        ("moments = [", "moments = [[1.0], ", "scores.moments"),
        ("moments = [\n  [", "moments = [\n  [-", "scores.moments: has a negative"),
        ("region_freedom = ", "region_freedom = -", "scores.region_freedom"),
        ("rig_id = ", "rig_id = 3 #", "rig_id"),
        ("[right_lens]", "[right_lens", "no TOML"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused_with_the_key_that_is_wrong(old: str, new: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "RIG.toml"
    text = text_of(made())
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=r"wayloom calibrate") as raised:
        read_rig_file(file)
    assert says in str(raised.value)
    assert str(file) in str(raised.value)


def test_a_file_of_format_1_still_gives_its_lens_and_takes_no_drives(tmp_path: Path) -> None:
    text = text_of(made()).replace("format_version = 2", "format_version = 1").replace("[normal_equations]", "[evidence]")
    (tmp_path / "RIG.toml").write_text(text[: text.index("# Of the match groups' scores")])
    back = read_rig_file(tmp_path / "RIG.toml")
    assert (back.lens, back.scores) == (LENS, None)
    with pytest.raises(CalibrationError, match=r"format 1 .*learn it again from the observations of all its drives"):
        learn_rig([], known=back)


def test_a_file_that_is_not_there_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no such file"):
        read_rig_file(tmp_path / "RIG.toml")


def scaled(focal: float = 1.0, baseline: float = 1.0) -> StereoRig:
    camera = PinholeCamera(focal * 718.856, focal * 717.1, 607.1928, 185.2157, 1241, 376)
    return StereoRig(camera, (-0.5372 * baseline, 0.0, 0.0))


def test_the_file_of_another_rig_is_refused() -> None:
    with pytest.raises(CalibrationError, match="is of the rig car-7, the log of car-8"):
        differences(made(), RIG, "car-8", file="RIG.toml")
    with pytest.raises(CalibrationError, match=r"baseline differs by 10.0 %"):
        differences(made(), scaled(baseline=1.1), "car-7", file="RIG.toml")


def test_another_calibration_of_the_same_rig_and_an_unnamed_one_are_doubts() -> None:
    assert differences(made(), RIG, "car-7", file="RIG.toml") == ()
    assert "1.70 %" in differences(made(), scaled(focal=0.983), "car-7", file="RIG.toml")[0]
    assert "unknown" in differences(made(), RIG, None, file="RIG.toml")[0]


def test_every_parameter_stands_in_the_file_under_its_name() -> None:
    text = text_of(made())
    for name in PARAMETERS:
        assert text.count(f"\n{name} = ") == 3


def test_what_drives_tell_of_the_receiver_comes_back_with_its_drives(tmp_path: Path) -> None:
    told = tuple(ReceiverEvidence(f"day {k}", k, np.diag([4e5, 1e3, 0.0, 1e3]) + k, np.arange(4.0)) for k in (1, 2))
    write_rig_file(replace(made(), receivers=told), tmp_path / "RIG.toml")
    assert "ms late" in (tmp_path / "RIG.toml").read_text()
    back = read_rig_file(tmp_path / "RIG.toml").receivers
    assert [(one.drive_id, one.t_ns) for one in back] == [("day 1", 1), ("day 2", 2)]
    for one, two in zip(back, told, strict=True):
        np.testing.assert_array_equal(one.information, two.information)
        np.testing.assert_array_equal(one.pull, two.pull)


@pytest.mark.parametrize(
    ("wrong", "what"), [("pull = [0.0, 1.0]", "4 numbers"), ('t_ns = "noon"', "whole number"), ("information = [[1.0]]", "4 rows")]
)
def test_a_damaged_receiver_is_told_with_its_key(tmp_path: Path, wrong: str, what: str) -> None:
    write_rig_file(replace(made(), receivers=(ReceiverEvidence("one", 5, np.eye(4), np.zeros(4)),)), tmp_path / "RIG.toml")
    text, key = (tmp_path / "RIG.toml").read_text(), wrong.split(" ")[0]
    before, _, after = text.partition("[[receiver]]")
    pattern = rf"{key} = \[\n(  \[.*\],\n)*\]" if key == "information" else rf"{key} = .*"
    (tmp_path / "RIG.toml").write_text(before + "[[receiver]]" + re.sub(pattern, wrong, after, count=1))
    with pytest.raises(CalibrationError, match=what):
        read_rig_file(tmp_path / "RIG.toml")
