"""`wayloom models` says which networks there are, and whether they are here."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name != "WAYLOOM_MODELS"}
    return subprocess.run(
        [sys.executable, "-m", "wayloom.cli.main", "models", *arguments],
        env={**kept, "PYTHONPATH": str(ROOT / "core"), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_network_is_listed_with_its_licence_and_its_state() -> None:
    done, told = run(), run("--json")
    assert done.returncode == 0
    assert "wayloom-city (default): ready" in done.stdout
    rows = {row["name"]: row for row in json.loads(told.stdout)["models"]}
    assert rows["deeplab-slim"]["state"] == "absent"
    assert "Apache-2.0" in rows["deeplab-slim"]["licence"]
    assert rows["deeplab-slim"]["source"] in done.stdout


def test_a_network_in_a_folder_of_wayloom_models_is_ready(models_dir: Path) -> None:
    done = run("deeplab-slim", WAYLOOM_MODELS=str(models_dir))
    assert done.returncode == 0
    assert done.stdout.startswith("deeplab-slim: ready")
    assert "wayloom-city" not in done.stdout


def test_an_unknown_network_is_bad_input_told_in_one_line() -> None:
    done = run("no-such-network")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "wayloom-city" in done.stderr
    assert done.stdout == ""
