"""The list of kernels that are compiled before the stages that call them."""

import inspect
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from wayloom.config.kernel_types import types_of, words_of
from wayloom.config.stages import drive_stages
from wayloom.pipeline.code_version import code_version
from wayloom.pipeline.kernels_ahead import listed

LISTED = [(one["module"], name, types) for one in listed() for name, types in one["kernels"]]


def test_there_are_kernels_of_the_stages_that_compile_most() -> None:
    stages = {stage for one in listed() for stage in one["stages"]}
    assert {"ground", "labelling", "objects", "looks", "stitch"} <= stages <= {*drive_stages(), "stitch"}
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
        for stage in set(one["stages"]) - {"stitch"}:
            assert one["module"] in closures[stage]


def test_what_was_compiled_ahead_is_there_for_the_next_process(tmp_path: Path) -> None:
    code = "from wayloom.pipeline.kernels_ahead import compile_stage; print(compile_stage('objects'))"
    environment = {name: text for name, text in os.environ.items() if name != "NUMBA_DISABLE_JIT"}

    def compiled() -> int:
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment | {"NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, check=True
        )
        return int(done.stdout)

    assert compiled() == sum(len(one["kernels"]) for one in listed() if "objects" in one["stages"])
    assert compiled() == 0
