"""Modules that a process of the API loads at its start: memory of each, whatever it is asked for."""

import subprocess
import sys

BY_USE = ("numba", "llvmlite", "scipy", "mcap", "wayloom.logs.registry", "wayloom.odometry.result", "onnxruntime", "gtsam")
"""What a few endpoints load by their first use."""


def test_the_api_starts_without_what_only_a_few_endpoints_need() -> None:
    code = "import sys, wayloom_services.__main__; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(said.stdout.split())
    assert "wayloom_services.app" in loaded
    assert not loaded.intersection(BY_USE)
