"""The whole way through a real service: a real log goes in over HTTP, a picture of the map made of tiles comes out."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.real_log import first_frames
from wayloom.config.classes import PALETTE


def demo(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "wayloom.cli.main", "demo", "--once", "--port", "0", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, env=os.environ | {"WAYLOOM_THREADS": "2"})


def map_of(out: Path) -> Path:
    """The picture of the only log that was mapped into this folder."""
    (picture,) = out.glob("log-street-*/map.png")
    return picture


def left_running(folder: Path) -> list[str]:
    """Processes that still name the folder."""
    listing = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout
    return [line for line in listing.splitlines() if str(folder) in line]


@pytest.mark.real_data
def test_a_real_drive_goes_in_and_its_map_comes_out(clip_a: Path, clip_a_gnss: Path, tmp_path: Path):
    log = first_frames(clip_a, tmp_path / "street", 40)
    done = demo("--log", str(log), "--gnss", str(clip_a_gnss), "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr + done.stdout
    for stage in ("ingest", "odometry", "segmentation", "labelling", "georeference", "submaps", "stitch", "publish"):
        assert f"street, {stage}: done" in done.stdout
    assert "knows simulated streets only" in done.stdout
    picture = cv2.imread(str(map_of(tmp_path / "out")))[..., ::-1]
    ground = picture[:, :-190].reshape(-1, 3)
    mapped = (ground[:, None] == PALETTE[None]).all(axis=2).any(axis=1)
    assert np.count_nonzero(mapped) > 500
    assert left_running(tmp_path / "out") == []


@pytest.mark.real_data
def test_a_drive_without_gnss_is_shown_in_its_own_frame(clip_a: Path, tmp_path: Path):
    log = first_frames(clip_a, tmp_path / "street", 24)
    done = demo("--log", str(log), "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr + done.stdout
    assert "not geo-referenced" in done.stdout
    assert cv2.imread(str(map_of(tmp_path / "out"))) is not None


def test_a_bad_log_ends_the_demo_before_anything_is_started(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    done = demo("--log", str(tmp_path / "empty"), "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "empty" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.real_data
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_however_the_demo_ends_its_service_ends_too(clip_a: Path, tmp_path: Path, number: signal.Signals):
    log = first_frames(clip_a, tmp_path / "street", 24)
    command = [sys.executable, "-m", "wayloom.cli.main", "demo", "--port", "0", "--log", str(log), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    next(line for line in process.stdout if "the service runs" in line)
    process.send_signal(number)
    process.wait(30)
    deadline = time.monotonic() + 20
    while left_running(tmp_path / "out") and time.monotonic() < deadline:
        time.sleep(0.2)
    assert left_running(tmp_path / "out") == []
    process.stdout.close()
