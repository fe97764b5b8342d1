"""`wayloom simulate`: drives of the simulated city."""

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Size(StrEnum):
    """Share of KITTI-360's image size."""

    full = "full"
    half = "half"
    quarter = "quarter"


class LogFormat(StrEnum):
    """Layout of the logs."""

    kitti = "kitti"
    kitti_raw = "kitti-raw"


def simulate_command(
    preset: Annotated[str, typer.Argument(help="What to drive: demo.")],
    out: Annotated[Path, typer.Option(help="Folder for the drives, one folder a vehicle.")],
    size: Annotated[Size, typer.Option(help="Size of the images: full is 1408x376.")] = Size.half,
    seed: Annotated[int | None, typer.Option(min=0, help="Another city than the preset's.")] = None,
    format: Annotated[LogFormat, typer.Option(help="Layout of the logs.")] = LogFormat.kitti,
    truth: Annotated[bool, typer.Option("--truth", help="Also write depth, class and instance of every pixel.")] = False,
    threads: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; the result does not depend on it.")] = None,
) -> None:
    """Draw drives of a synthetic city, with GNSS and exact truth."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from wayloom.simulation.simulate import simulate

    columns = (BarColumn(32), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn(), TextColumn("{task.description}"))
    console = Console(file=sys.stderr)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        task = bars.add_task("starting", total=1.0)
        paths = simulate(
            preset, out, size.value, seed, format.value, truth, threads or min(4, os.cpu_count() or 1),
            lambda share, what: bars.update(task, completed=share, description=what),
        )  # fmt: skip
    for path in paths:
        typer.echo(path)
