"""`wayloom process` as a user runs it: exit status, one line for each mistake, and life after kill -9."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.real_log import FRAMES, colour_network, damage, first_frames

WAYLOOM = (sys.executable, "-m", "wayloom.cli.main")


@pytest.fixture(scope="module")
def log_path(clip_a, tmp_path_factory):
    return first_frames(clip_a, tmp_path_factory.mktemp("log") / "street")


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return str(colour_network(tmp_path_factory.mktemp("network")))


def wayloom(*arguments, **options):
    return subprocess.run([*WAYLOOM, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=600, **options)


def stage_times(out):
    return {file.parent.name: file.stat().st_mtime_ns for file in (out / "stages").glob("*/stage.json")}


def kill_when(process, finished, limit_s=300.0):
    """Kill the process as soon as `finished` exists."""
    end = time.monotonic() + limit_s
    while not finished.exists():
        assert process.poll() is None, "ended before it could be killed"
        assert time.monotonic() < end
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()


@pytest.mark.parametrize("stage", ["ingest", "odometry"])
def test_a_run_after_kill_9_finishes_without_redoing_what_was_done(log_path, network, tmp_path, stage):
    out = tmp_path / "out"
    command = [*WAYLOOM, "process", str(log_path), "--out", str(out), "--model", network]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    kill_when(process, out / "stages" / stage / "stage.json")
    before = stage_times(out)
    assert stage in before
    assert not (out / "report.json").exists()
    ended = wayloom("process", log_path, "--out", out, "--model", network, "--json")
    assert ended.returncode == 0, ended.stderr
    after = stage_times(out)
    assert {name: after[name] for name in before} == before
    stages = json.loads(ended.stdout)["stages"]
    assert f"{FRAMES} of {FRAMES} frames tracked" in ended.stderr
    assert [name for name, said in stages.items() if said["reused"]] == [name for name in stages if name in before]
    assert not list((out / "stages").glob(".unfinished-*"))


def test_a_good_run_says_what_it_made(log_path, network, tmp_path):
    ended = wayloom("process", log_path, "--out", tmp_path / "out", "--model", network, "--threads", 1)
    assert ended.returncode == 0, ended.stderr
    assert f"{FRAMES} of {FRAMES} frames tracked" in ended.stdout
    assert str(tmp_path / "out" / "report.html") in ended.stdout
    assert "odometry: done" in ended.stderr


def refused(ended, *words):
    """One line, exit status 2, no traceback."""
    assert ended.returncode == 2, ended.stderr
    lines = [line for line in ended.stderr.splitlines() if line.startswith("wayloom: ")]
    assert len(lines) == 1
    assert "Traceback" not in ended.stderr
    for word in words:
        assert word in lines[0]


def test_a_missing_log_is_named(tmp_path, network):
    refused(wayloom("process", tmp_path / "nowhere", "--out", tmp_path / "out", "--model", network), "nowhere")
    assert not list(tmp_path.iterdir())


def test_a_damaged_image_is_named_and_nothing_is_left(clip_a, network, tmp_path):
    bad = first_frames(clip_a, tmp_path / "bad", 5)
    damage(bad / "image_1" / "000003.png")
    refused(wayloom("process", bad, "--out", tmp_path / "out", "--model", network), "000003.png")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("origin", ["here", "8.4,49", "8.4,149,0", "nan,49,0"])
def test_an_origin_that_is_no_place_is_refused(log_path, tmp_path, origin):
    refused(wayloom("process", log_path, "--out", tmp_path / "out", "--origin", origin), "--origin", "LON,LAT,HEIGHT")


def test_names_that_are_no_text_do_no_harm(clip_a, network, tmp_path):
    log, out = (os.fsdecode(os.fsencode(tmp_path) + name) for name in (b"/caf\xe9", b"/out\xff"))
    first_frames(clip_a, Path(log), 6)
    ended = wayloom("process", log, "--out", out, "--model", network)
    assert ended.returncode == 0, ended.stderr
    assert "out\\udcff/report.html" in ended.stdout


def test_lost_frames_are_a_warning_and_no_failure(clip_a, network, tmp_path):
    log = first_frames(clip_a, tmp_path / "log", 8)
    for side in ("image_0", "image_1"):
        cv2.imwrite(str(log / side / "000005.png"), np.zeros((376, 1241), np.uint8))
    ended = wayloom("process", log, "--out", tmp_path / "out", "--model", network)
    assert ended.returncode == 0, ended.stderr
    assert "wayloom: warning: 1 of 8 frames were lost (first frame 5: the image is blank)" in ended.stderr


def test_an_unknown_network_is_refused_with_the_known_ones(log_path, tmp_path):
    refused(wayloom("process", log_path, "--out", tmp_path / "out", "--model", "resnet"), "resnet", "deeplab-slim")


def small_files_only():
    """As a full disk: a write beyond 64 KiB fails with EFBIG."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))


def test_a_write_that_fails_is_one_line_and_leaves_no_half_stage(log_path, network, tmp_path):
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    arguments = ("process", log_path, "--out", tmp_path / "out", "--model", network)
    refused(wayloom(*arguments, preexec_fn=small_files_only, env=environment), "cannot be written")
    assert {path.name for path in (tmp_path / "out" / "stages").iterdir()} <= {"ingest", ".lock"}
