"""No stage takes a larger share of a drive's CPU than in the committed runs (`benchmarks/cost.json`), nor more memory than a worker
has."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pipeline.real_log import first_frames

ROOT = Path(__file__).resolve().parents[2]
MORE, A_LITTLE = 1.25, 0.01
"""Runs on one machine differ by up to a fourteenth of a share (`noise`); another processor weighs the stages otherwise by more."""
RUNS = 8
"""At most: other work makes a stage dearer, never cheaper, so more runs come closer to what it costs."""
WORKER_BYTES = 1.2e9
"""What a process that maps drives may take."""
COMMITTED: dict[str, Any] = json.loads((ROOT / "benchmarks" / "cost.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def street(clip_a: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive that is measured."""
    return first_frames(clip_a, tmp_path_factory.mktemp("cost") / "street")


@pytest.fixture(scope="module")
def peaks(street: Path, clip_a_gnss: Path) -> dict[str, float]:
    """Bytes that the process on two cores held at most during each stage, and what went on beside it."""
    return _of_stages("peak", street, street.parent / "first", clip_a_gnss, cores=2)


@pytest.fixture(scope="module")
def shares(peaks: dict[str, float], street: Path, clip_a_gnss: Path) -> dict[str, float]:
    """Of each stage the share of all stages' CPU, each in its best run; the first, which may compile kernels, counts not."""
    least: dict[str, float] = {}
    shares: dict[str, float] = {}
    for run in range(RUNS):
        for name, seconds in _of_stages("cpu_s", street, street.parent / f"out-{run}", clip_a_gnss).items():
            least[name] = min(seconds, least.get(name, seconds))
        shares = {name: seconds / sum(least.values()) for name, seconds in least.items()}
        if run and all(shares[name] <= _allowed(name) for name in COMMITTED["shares"]):
            break
    return shares


def _allowed(stage: str) -> float:
    return MORE * float(COMMITTED["shares"][stage]) + A_LITTLE


def _of_stages(what: str, log: Path, out: Path, gnss: Path, cores: int = 1) -> dict[str, float]:
    words = [sys.executable, ROOT / "benchmarks" / "drive_cost.py", log, out, "--gnss", gnss, "--cores", cores]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run(list(map(str, words)), env=environment, capture_output=True, text=True, check=True)
    stages = json.loads(run.stdout)["stages"]
    return {name: stage[what] for name, stage in stages.items() if name != "all"}


@pytest.mark.real_data
@pytest.mark.parametrize("stage", COMMITTED["shares"])
def test_a_stage_takes_no_larger_share_of_a_drives_cpu_than_before(stage: str, shares: dict[str, float]) -> None:
    assert shares[stage] <= _allowed(stage)


@pytest.mark.parametrize("stage", COMMITTED["shares"])
def test_what_is_allowed_is_beyond_the_noise_of_the_committed_runs(stage: str) -> None:
    assert 2.0 * COMMITTED["noise"][stage] < _allowed(stage) - COMMITTED["shares"][stage]


@pytest.mark.real_data
def test_no_stage_takes_more_memory_than_a_worker_has(peaks: dict[str, float]) -> None:
    assert peaks.keys() == COMMITTED["shares"].keys()
    assert max(peaks.values()) < WORKER_BYTES
