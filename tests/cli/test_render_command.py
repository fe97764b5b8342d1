"""`wayloom render` by its command line."""

import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from exports.made_sources import drives_with_ground


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "wayloom.cli.main", "render", *arguments], capture_output=True, text=True)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return drives_with_ground(tmp_path_factory.mktemp("street"))


def test_drives_are_drawn_from_one_side_at_the_size_that_is_asked_for(folders: list[Path], tmp_path: Path) -> None:
    done = run(*map(str, folders), "--out", str(tmp_path / "a.png"), "--size", "640x360", "--colour", "drives")
    assert done.returncode == 0, done.stderr
    assert "640 x 360 pixels" in done.stdout
    assert cv2.imread(str(tmp_path / "a.png")).shape == (360, 640, 3)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("--size", "640"), "--size 640 is no size"),
        (("--view", "inside"), "known are top, oblique, fly"),
        (("--colour", "age"), "known are class, height, grey, drives"),
    ],
)
def test_what_is_not_known_is_one_line_and_status_2(arguments: tuple[str, ...], what: str, tmp_path: Path) -> None:
    done = run("nowhere", "--out", str(tmp_path / "a.png"), *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert what in done.stderr
