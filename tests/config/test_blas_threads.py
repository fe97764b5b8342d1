"""Threads of the linear algebra library in our programs, and in a notebook of somebody else's."""

import os
import subprocess
import sys

import pytest

from wayloom.config.blas_threads import VARIABLE


def value_after(module: str, given: str | None = None) -> str:
    environment = {name: text for name, text in os.environ.items() if name != VARIABLE} | ({VARIABLE: given} if given else {})
    code = f"import sys, os, {module}; print(os.environ.get('{VARIABLE}'), 'numpy' in sys.modules)"
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize("program", ["wayloom.cli", "wayloom_workers", "wayloom_services"])
def test_programs_take_one_before_numpy_is_loaded(program: str) -> None:
    assert value_after(program) == "1 False"


def test_the_users_own_number_stands() -> None:
    assert value_after("wayloom_workers", "3") == "3 False"


def test_a_notebook_keeps_its_own() -> None:
    assert value_after("wayloom") == "None False"
