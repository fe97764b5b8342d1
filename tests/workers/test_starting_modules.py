"""Modules that a worker loads before its first job: seconds of each start, whatever it will work on."""

import subprocess
import sys

LOADED = """
import sys
from wayloom.pipeline.settings import load_settings
from wayloom_workers.__main__ import load_hooks
load_hooks(load_settings().settings.stage_hooks)
print(*sys.modules)
"""


def test_a_worker_starts_without_what_draws_its_reports_and_what_stitches() -> None:
    said = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    loaded = set(said.stdout.split())
    assert "wayloom_workers.production" in loaded
    assert not loaded.intersection({"matplotlib", "gtsam", "wayloom_workers.stitching"})
