"""Kernels of the stages, compiled ahead of their use by the list that `benchmarks/record_kernels.py` writes.

What is missing in the list is compiled where it is first called, as numba does it: the list saves time, it is not needed.

`python -m wayloom.pipeline.kernels_ahead` compiles them all, in the order of the stages and at low priority, into the cache that
all processes of this installation use.
"""

import json
import os
import sys
from collections.abc import Sequence
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from wayloom.config.kernel_cache import KernelGroup, compile_kernels
from wayloom.config.kernel_types import types_of
from wayloom.config.progress import Progress, silent
from wayloom.odometry.warm_up import compile_odometry

LOW_PRIORITY: Final = 10

LIST: Final = Path(__file__).with_name("kernels.json")
"""[{"module", "stages": [...], "kernels": [[name, types]]}]: a module of kernels, the stages that call it, and its kernels with the
types of their arguments (`wayloom.config.kernel_types`), in the order of their first use."""


def compile_stage(stage: str, progress: Progress = silent) -> int:
    """Compile what the stage calls and the cache lacks; returns how many kernels. Processes at the same stage share the work."""
    return compile_kernels([_group(one) for one in listed() if stage in one["stages"]], progress)


@lru_cache(1)
def listed() -> Sequence[dict[str, Any]]:
    """Content of the list."""
    return tuple(json.loads(LIST.read_text(encoding="utf-8")))


def _group(one: dict[str, Any]) -> KernelGroup:
    return KernelGroup(one["module"].removeprefix("wayloom."), partial(_kernels, one["module"], one["kernels"]))


def _kernels(module: str, kernels: Sequence[tuple[str, str]]) -> list[tuple[Any, tuple[Any, ...]]]:
    found = import_module(module)
    return [(getattr(found, name), types_of(words)) for name, words in kernels]


def main() -> None:
    """Compile all, and tell on stderr how far it is."""
    os.nice(LOW_PRIORITY)

    def say(_share: float, what: str, /) -> None:
        sys.stderr.write(f"{what}\n")

    compile_odometry(True, say)
    compile_kernels([_group(one) for one in listed()], say)


if __name__ == "__main__":
    main()
