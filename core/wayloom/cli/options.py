"""Options that several commands share."""

import os
from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", help="Settings file (TOML), also by WAYLOOM_CONFIG; `wayloom config show` prints what is in force."),
]


def default_threads() -> int:
    """The cores that this process may use."""
    return min(64, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
