"""The cache of compiled kernels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from wayloom.config.kernel_cache import kernel_digest, use_kernel_cache


def package(folder: Path, callee: str) -> Path:
    (folder / "room" / "kernels").mkdir(parents=True, exist_ok=True)
    (folder / "room" / "kernels" / "caller.py").write_text("from room.kernels.callee import f\n")
    (folder / "room" / "kernels" / "callee.py").write_text(callee)
    (folder / "room" / "other.py").write_text(callee)
    return folder


def test_a_change_in_any_kernel_gives_another_cache(tmp_path: Path):
    before = kernel_digest(package(tmp_path, "def f(): return 1\n"))
    after = kernel_digest(package(tmp_path, "def f(): return 2\n"))
    assert before != after


def test_what_is_no_kernel_changes_nothing(tmp_path: Path):
    before = kernel_digest(package(tmp_path, "def f(): return 1\n"))
    (tmp_path / "room" / "other.py").write_text("x = 3\n")
    assert kernel_digest(tmp_path) == before


def test_the_users_own_cache_folder_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "elsewhere"))
    use_kernel_cache(package(tmp_path, ""))
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "elsewhere")
    assert not (tmp_path / "elsewhere").exists()


def test_kernels_are_compiled_into_that_folder(tmp_path: Path):
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | {
        "XDG_CACHE_HOME": str(tmp_path)
    }
    code = (
        "import numpy as np, wayloom; from wayloom.odometry.kernels.linear import solve_spd as f;"
        "x = np.zeros(2); f(np.eye(2), np.ones(2), x)"
    )
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=300)
    (folder,) = (tmp_path / "wayloom").iterdir()
    assert list(folder.rglob("*.nbi"))


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_where_the_cache_cannot_be_written_it_goes_with_the_process(tmp_path: Path, variable: str):
    (tmp_path / "file").write_text("in the way")
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {variable: str(tmp_path / "file" / "cache"), "TMPDIR": str(tmp_path)}
    code = (
        "import numpy as np, wayloom; from wayloom.odometry.kernels.linear import solve_spd as f;"
        "x = np.zeros(2); f(np.eye(2), np.ones(2), x); print(x)"
    )
    done = subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=300, capture_output=True, text=True)
    assert done.stdout == "[1. 1.]\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
