"""`wayloom config show`, and `--config` of the commands."""

import json
import os
import subprocess
import sys
from pathlib import Path

from logs.made_drives import write_drive


def wayloom(*arguments: object, **variables: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WAYLOOM_")}
    command = [sys.executable, "-m", "wayloom.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=kept | variables)


def test_it_prints_a_file_that_gives_the_same_settings_again(tmp_path: Path) -> None:
    first = wayloom("config", "show", WAYLOOM_THREADS="3", WAYLOOM_ODOMETRY__AFFINE_PRIOR="2,0.5", WAYLOOM_API_KEY="k" * 20)
    assert first.returncode == 0, first.stderr
    assert "threads = 3  # WAYLOOM_THREADS: " in first.stdout
    assert "# api_key is set and not shown" in first.stdout
    (tmp_path / "again.toml").write_text(first.stdout)
    again = wayloom("config", "show", "--config", tmp_path / "again.toml", "--json")
    shown = json.loads(again.stdout)
    assert shown["settings"]["odometry"]["affine_prior"] == [2.0, 0.5]
    assert shown["origins"]["threads"] == str(tmp_path / "again.toml")
    assert shown["origins"]["api_key"] == "default"


def test_a_bad_file_is_one_line_and_status_2_for_every_command(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[odometry]\nwindow = 99\n")
    drive = write_drive(tmp_path, "kitti-odometry")
    commands = (
        ("config", "show"), ("process", drive, "--out", tmp_path / "out"), ("odometry", drive, "--out", tmp_path / "t.tum"),
        ("upload", drive, "--to", "http://127.0.0.1:9"), ("up", "--data", tmp_path / "data"),
        ("demo", "--once", "--out", tmp_path / "out"),
    )  # fmt: skip
    for command in commands:
        done = wayloom(*command, "--config", tmp_path / "bad.toml")
        assert done.returncode == 2, command
        assert done.stderr.splitlines() == [line for line in done.stderr.splitlines() if "bad.toml, odometry.window: 99: " in line]
        assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
