"""What the network's runtime may tell about the machine: nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("what", [["-c", "import wayloom.segmentation.network"], ["-m", "wayloom.cli.main", "doctor"]])
def test_onnxruntime_keeps_no_record_of_the_machine(tmp_path: Path, what: list[str]) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("CI", "ORT_DISABLE_TELEMETRY")}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    subprocess.run([sys.executable, *what], env=environment, check=True, timeout=120)
    left = [path for path in tmp_path.rglob("*") if path.is_file() and "onnxruntime" in str(path).lower()]
    assert left == []
