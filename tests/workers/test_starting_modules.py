"""Modules that a worker loads before its first job: seconds of each start, whatever it will work on."""

import subprocess
import sys

BY_USE = {"matplotlib", "gtsam", "wayloom_workers.stitching"}
"""What only some jobs need."""


def test_a_worker_starts_without_what_draws_its_reports_and_what_stitches() -> None:
    code = "import sys, wayloom_workers.__main__, wayloom_workers.production; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not BY_USE.intersection(said.stdout.split())
