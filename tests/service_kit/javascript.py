"""Packages of npm that tests try our files with, pinned in tests/javascript, installed once into a cache folder."""

import fcntl
import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

PINNED = Path(__file__).resolve().parents[1] / "javascript"
FILES = ("package.json", "package-lock.json", ".npmrc")


def packages() -> Path:
    """The folder that holds `node_modules`. Without node and npm, or a registry: a failure in CI and a skip elsewhere."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        _give_up("no node and npm on this machine: install Debian's nodejs and npm")
    digest = hashlib.sha256(b"".join((PINNED / name).read_bytes() for name in FILES)).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "wayloom-tests" / f"npm-{digest}"
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "lock").open("w") as lock:  # one of the processes that run tests installs, the others wait
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (cache / "installed").exists():
            for name in FILES:
                shutil.copy(PINNED / name, cache / name)
            command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
            done = subprocess.run(command, cwd=cache, capture_output=True, text=True, timeout=600)
            if done.returncode:
                _give_up(f"npm ci: {done.stderr[-500:]}")
            (cache / "installed").touch()
    return cache


def gltf_errors(files: list[Path]) -> list[tuple[str, str, str]]:
    """What the Khronos glTF validator calls an error or a warning: file, code, message."""
    command = ["node", str(PINNED / "validate_gltf.cjs"), str(packages()), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return [(Path(file).name, code, message) for file, code, severity, message in json.loads(done.stdout) if severity <= 1]


def _give_up(message: str) -> None:
    if os.environ.get("CI"):
        pytest.fail(message)
    pytest.skip(message)
