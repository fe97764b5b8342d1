"""What a command says while it works: lines where nobody looks at a terminal, bars where somebody does."""

import io
import sys

import pytest

from wayloom.cli.progress_bars import ProgressBars


def test_each_piece_of_work_ends_with_one_line() -> None:
    lines = io.StringIO()
    with ProgressBars(lines) as bars:
        for share, what in ((0.0, "starting"), (0.5, "half"), (1.0, "done"), (1.0, "done")):
            bars("odometry")(share, what)
        bars("labelling")(0.4, "voting")
    assert lines.getvalue() == "odometry: done\n"


def test_long_work_says_each_quarter_once_too() -> None:
    lines = io.StringIO()
    with ProgressBars(lines, quarters=True) as bars:
        progress = bars("odometry")
        for percent in range(0, 101, 5):
            progress(percent / 100, f"frame {percent}")
    assert lines.getvalue().splitlines() == [
        "odometry   0 %: frame 0",
        "odometry  25 %: frame 25",
        "odometry  50 %: frame 50",
        "odometry  75 %: frame 75",
        "odometry: frame 100",
    ]


def test_work_that_begins_again_ends_again() -> None:
    lines = io.StringIO()
    with ProgressBars(lines) as bars:
        for share, what in ((1.0, "done"), (0.2, "again"), (1.0, "done at last")):
            bars("stitch")(share, what)
    assert lines.getvalue() == "stitch: done\nstitch: done at last\n"


class Terminal(io.StringIO):
    """What is written to it is shown on a screen."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_services_work_that_is_done_tells_its_own_seconds_alone(elsewhere: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    now = [0.0]
    with ProgressBars(elsewhere=elsewhere) as bars:
        bars._bars.get_time = lambda: now[0]
        bars("drive, odometry")(0.5, "tracked half")
        now[0] = 1.1
        bars("drive, odometry")(1.0, "done in 42.0 s")
    last = screen.getvalue().rpartition("drive, odometry")[2]
    assert "done in 42.0 s" in last
    assert ("0:00:01" in last) == (not elsewhere)
