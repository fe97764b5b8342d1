"""Heaps of our programs' threads, and those of a notebook of somebody else's."""

import ctypes
import os
import re
import subprocess
import sys

import pytest

from wayloom.config.one_heap import VARIABLE

BUSY = """
import ctypes, threading
library = ctypes.CDLL(None)
library.malloc.restype = ctypes.c_void_p
all_there = threading.Barrier(4)
def work():
    all_there.wait()
    library.malloc(ctypes.c_size_t(100_000))
    all_there.wait()
threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
library.malloc_stats()
"""


@pytest.fixture(autouse=True)
def glibc() -> None:
    """Whose heaps `malloc_stats` counts. Another C library is a failure in CI and a skip elsewhere."""
    if not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"):
        (pytest.fail if os.environ.get("CI") else pytest.skip)("heaps are counted by glibc's malloc_stats")


def heaps_after(module: str, given: str | None = None) -> int:
    environment = {name: text for name, text in os.environ.items() if name != VARIABLE} | ({VARIABLE: given} if given else {})
    ran = subprocess.run(
        [sys.executable, "-c", f"import {module}{BUSY}"], env=environment, capture_output=True, text=True, check=True
    )
    return len(re.findall(r"^Arena \d+:", ran.stderr, re.MULTILINE))


@pytest.mark.parametrize("program", ["wayloom.cli", "wayloom_workers"])
def test_threads_of_the_programs_share_one(program: str) -> None:
    assert heaps_after(program) == 1


def test_the_users_own_number_stands() -> None:
    assert heaps_after("wayloom.cli", "3") == 3


def test_a_notebook_keeps_its_own() -> None:
    assert heaps_after("wayloom") > 1


FREED = """
import ctypes
from pathlib import Path
from wayloom.config.one_heap import give_back, use_one_heap
use_one_heap()
library = ctypes.CDLL(None)
library.malloc.restype, library.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
def held_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
blocks = [library.malloc(ctypes.c_size_t(60_000)) for _ in range(2_000)]
for block in blocks:
    ctypes.memset(block, 1, 60_000)
for block in blocks[:-1]:
    library.free(block)
before = held_mb()
give_back()
print(before - held_mb())
"""


def test_what_is_freed_below_something_in_use_is_given_back() -> None:
    ran = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True)
    assert float(ran.stdout) > 100.0
