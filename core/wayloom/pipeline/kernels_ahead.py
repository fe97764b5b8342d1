"""Kernels of the stages, compiled ahead of their use by the list that `benchmarks/record_kernels.py` writes.

What is missing in the list is compiled where it is first called, as numba does it: the list saves time, it is not needed.

`python -m wayloom.pipeline.kernels_ahead` compiles them all, in the order of the stages and at low priority, into the cache that
all processes of this installation use; with names of stages, theirs, and with --imu those of inertial odometry.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import IO, Any, Final

from wayloom.config.child_processes import ending_with_parent
from wayloom.config.kernel_cache import KernelGroup, compile_kernels, lacking
from wayloom.config.kernel_types import types_of
from wayloom.config.progress import Progress, silent
from wayloom.config.stages import ODOMETRY
from wayloom.odometry.warm_up import odometry_groups

PROGRAM: Final = "wayloom.pipeline.kernels_ahead"
LOW_PRIORITY: Final = 10

LIST: Final = Path(__file__).with_name("kernels.json")
"""[{"module", "stages": [...], "kernels": [[name, types]]}]: a module of kernels, the stages that call it, and its kernels with the
types of their arguments (`wayloom.config.kernel_types`), in the order of their first use."""


def compile_stages(stages: Sequence[str], progress: Progress = silent, imu: bool = False, threads: int = 1) -> int:
    """Compile what these stages call and the cache lacks, and say which of how many kernels it is; returns how many are there now
    that were not.

    imu : whether the odometry is inertial
    threads : so many processes compile at a time, and end: what a compiler takes of memory, half a gigabyte, it never gives back
    Processes of others that compile the same kernels share the work. Kernels whose process ends badly are left to their first call.
    """
    groups = groups_of(stages, imu)
    before = lacking(groups)
    if not before:
        return 0
    total = sum(group.size for group in before)
    with _compilers(stages, imu, min(threads, len(before))) as compiled:
        for done, _ in enumerate(compiled):
            progress(0.0, f"compiling kernels, {min(done + 1, total)} of {total} (first run only)")
    return total - sum(group.size for group in lacking(groups))


@contextmanager
def _compilers(stages: Sequence[str], imu: bool, processes: int) -> Iterator[IO[str]]:
    """So many processes that compile, or as many as the system lets begin, and what they write: a line as each kernel is begun.
    They are gone when the block ends."""
    command = [sys.executable, "-m", PROGRAM, *stages, *(["--imu"] if imu else [])]
    read, write = os.pipe()
    running: list[subprocess.Popen[bytes]] = []
    with os.fdopen(read, encoding="utf-8") as lines:
        try:
            with os.fdopen(write, "wb") as end, suppress(OSError):
                for _ in range(processes):
                    one = subprocess.Popen(
                        command, stdin=subprocess.DEVNULL, stdout=end, stderr=subprocess.DEVNULL,
                        preexec_fn=ending_with_parent(signal.SIGKILL), start_new_session=True,
                    )  # fmt: skip
                    running.append(one)
            yield lines
        finally:
            for one in running:
                one.kill()
                one.wait()


def groups_of(stages: Sequence[str], imu: bool = False) -> list[KernelGroup]:
    """The kernels that stages call, those of inertial odometry where imu says so."""
    odometry = odometry_groups(imu) if ODOMETRY in stages else []
    return [*odometry, *(_group(one) for one in listed() if not set(stages).isdisjoint(one["stages"]))]


@lru_cache(1)
def listed() -> Sequence[dict[str, Any]]:
    """Content of the list."""
    return tuple(json.loads(LIST.read_text(encoding="utf-8")))


def _group(one: dict[str, Any]) -> KernelGroup:
    module, kernels = one["module"], one["kernels"]
    return KernelGroup(module.removeprefix("wayloom."), partial(_kernels, module, kernels), len(kernels))


def _kernels(module: str, kernels: Sequence[tuple[str, str]]) -> list[tuple[Any, tuple[Any, ...]]]:
    found = import_module(module)
    return [(getattr(found, name), types_of(words)) for name, words in kernels]


def main() -> None:
    """Compile. With names of stages, a line on stdout as each kernel is begun; else tell on stderr how far it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stages", nargs="*", metavar="STAGE")
    parser.add_argument("--imu", action="store_true")
    options = parser.parse_args()
    if options.stages:
        compile_kernels(groups_of(options.stages, options.imu), begin=partial(print, flush=True))
        return
    os.nice(LOW_PRIORITY)

    def say(_share: float, what: str, /) -> None:
        sys.stderr.write(f"{what}\n")

    compile_kernels([*odometry_groups(True), *(_group(one) for one in listed())], say)


if __name__ == "__main__":
    main()
