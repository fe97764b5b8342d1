"""The cache of compiled kernels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from wayloom.config import kernel_cache
from wayloom.config.kernel_cache import KernelGroup, compile_kernels, kernel_digest, use_kernel_cache


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


class Kernel:
    """Stands for a compiled function: notes the types that it was compiled for."""

    def __init__(self) -> None:
        self.compiled: list[tuple[str, ...]] = []

    def compile(self, types: tuple[str, ...]) -> None:
        self.compiled.append(types)


def test_what_is_compiled_is_said_and_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    f, g, said = Kernel(), Kernel(), []
    groups = [KernelGroup("first", lambda: [(f, ("i",)), (g, ("j",))], 2), KernelGroup("second", lambda: [(f, ("k",))], 1)]
    assert compile_kernels(groups, lambda share, what: said.append((share, what))) == 3
    assert (f.compiled, g.compiled) == ([("i",), ("k",)], [("j",)])
    assert said == [(0.0, f"compiling kernels, {k} of 3 (first run only)") for k in (1, 2, 3)]
    assert compile_kernels(groups, lambda share, what: said.append((share, what))) == 0
    assert len(f.compiled) == 2
    assert len(said) == 3


def test_a_group_that_another_process_compiles_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    theirs, ours, said = Kernel(), Kernel(), []
    groups = [KernelGroup("theirs", lambda: [(theirs, ())], 1), KernelGroup("ours", lambda: [(ours, ())], 1)]
    code = (
        "import fcntl, pathlib, sys; held = open(sys.argv[1], 'a'); fcntl.flock(held, fcntl.LOCK_EX); print(flush=True);"
        "sys.stdin.read(); pathlib.Path(sys.argv[1]).with_suffix('.compiled').touch()"
    )
    lock = kernel_cache._mark(tmp_path, groups[0]).with_suffix(".lock")
    command = [sys.executable, "-c", code, str(lock)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        other.stdout.readline()

        def progress(share: float, what: str, /) -> None:
            said.append(what)
            if "another process" in what and other.stdin is not None and not other.stdin.closed:
                other.stdin.close()

        assert compile_kernels(groups, progress) == 1
    assert (len(theirs.compiled), len(ours.compiled)) == (0, 1)
    assert "compiling kernels, 1 of 2: another process works on the others (first run only)" in said
