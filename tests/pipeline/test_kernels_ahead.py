"""The list of kernels that are compiled before the stages that call them."""

import inspect
import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from wayloom.config.kernel_types import types_of, words_of
from wayloom.config.stages import drive_stages
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.kernels_ahead import PROGRAM, compile_stages, listed

LISTED = [(one["module"], name, types) for one in listed() for name, types in one["kernels"]]

OTHER = {"stitch", "exports"}
"""Stages that are no drive's."""


def test_there_are_kernels_of_the_stages_that_compile_most() -> None:
    stages = {stage for one in listed() for stage in one["stages"]}
    assert {"ground", "labelling", "objects", "looks", "loops", *OTHER} <= stages <= {*drive_stages(), *OTHER}
    assert len(LISTED) > 60


@pytest.mark.parametrize(("module", "name", "types"), LISTED, ids=[f"{module}.{name}" for module, name, _ in LISTED])
def test_a_listed_kernel_takes_arguments_of_these_types(module: str, name: str, types: str) -> None:
    kernel = getattr(import_module(module), name)
    assert len(types_of(types)) == len(inspect.signature(getattr(kernel, "py_func", kernel)).parameters)
    assert words_of(types_of(types)) == types


def test_a_stage_is_listed_with_kernels_that_it_imports() -> None:
    """Those of readers aside, which a stage finds by the log's format."""
    closures = {name: set(code_version(f"wayloom.pipeline.stages.{name}").modules) for name in drive_stages()}
    for one in listed():
        if one["module"].startswith("wayloom.logs."):
            continue
        for stage in set(one["stages"]) - OTHER:
            assert one["module"] in closures[stage]


COMPILING = """
import json, sys
from numba.core import event
from wayloom.pipeline import kernels_ahead

class Here(event.Listener):
    begun = 0
    def on_start(self, compiled): Here.begun += 1
    def on_end(self, compiled): pass

event.register("numba:compile", Here())
said = []
made = kernels_ahead.compile_stages(("objects",), lambda share, what: said.append(what), threads=2)
print(json.dumps([made, said, Here.begun, len(kernels_ahead.lacking(kernels_ahead.groups_of(("objects",))))]))
"""


def compiled_in(cache: Path, before: str = "") -> list[Any]:
    """What a process with this cache says: how many kernels were made, what was said, compilations of its own, groups that lack."""
    environment = {name: text for name, text in os.environ.items() if name != "NUMBA_DISABLE_JIT"} | {"NUMBA_CACHE_DIR": str(cache)}
    return json.loads(subprocess.check_output([sys.executable, "-c", before + COMPILING], env=environment, timeout=300))


def test_what_other_processes_compiled_ahead_is_there_and_said(tmp_path: Path) -> None:
    total = sum(len(one["kernels"]) for one in listed() if "objects" in one["stages"])
    said = [f"compiling kernels, {k + 1} of {total} (first run only)" for k in range(total)]
    assert compiled_in(tmp_path) == [total, said, 0, 0]
    assert compiled_in(tmp_path) == [0, [], 0, 0]


def test_kernels_whose_process_ends_badly_or_cannot_begin_are_left_to_their_first_call(tmp_path: Path) -> None:
    failing = "from wayloom.pipeline import kernels_ahead; kernels_ahead.PROGRAM = 'wayloom.no_such_module'\n"
    refused = "import sys; sys.executable = '/no/such/python'\n"
    groups = sum("objects" in one["stages"] for one in listed())
    assert [compiled_in(tmp_path, before) for before in (failing, refused)] == [[0, [], 0, groups]] * 2


def compilers_of_this_process() -> list[str]:
    """Numbers of those that run. A machine without /proc is a failure in CI and a skip elsewhere."""
    if not list(Path("/proc/self/task").glob("*/children")):
        (pytest.fail if os.environ.get("CI") else pytest.skip)("processes are looked up in /proc")
    numbers = [number for path in Path("/proc/self/task").glob("*/children") for number in path.read_text().split()]
    return [number for number in numbers if PROGRAM in Path(f"/proc/{number}/cmdline").read_text()]


def test_an_interrupt_ends_the_processes_that_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    running: list[str] = []

    def interrupt(_share: float, _what: str, /) -> None:
        running.extend(compilers_of_this_process())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compile_stages(("objects",), interrupt, threads=2)
    assert len(running) == 2
    assert compilers_of_this_process() == []
