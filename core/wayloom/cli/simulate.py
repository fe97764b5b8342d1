"""`wayloom simulate`: drives of the simulated city."""

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayloom.cli.progress_bars import ProgressBars


class Size(StrEnum):
    """Share of the rig's image size."""

    full = "full"
    half = "half"
    quarter = "quarter"


class LogFormat(StrEnum):
    """Layout of the logs."""

    kitti = "kitti"
    kitti_raw = "kitti-raw"
    kitti_360 = "kitti-360"
    euroc = "euroc"
    mcap = "mcap"


PRESET_HELP = (
    "What to drive: demo; loop, hard, changed (one way in a city, in one of look-alike blocks, in the same one later); "
    "fleet (vehicles that meet); benchmark (with LiDAR); photometry (hard light); movers (rush hour); "
    "rig (wrong calibrations); long (laps)."
)


def simulate_command(
    preset: Annotated[str, typer.Argument(help=PRESET_HELP)],
    out: Annotated[Path, typer.Option(help="Folder for the drives, one folder a vehicle.")],
    size: Annotated[Size, typer.Option(help="Size of the images: full is 1408x376, or 1241x376 of the rig kitti.")] = Size.half,
    seed: Annotated[int | None, typer.Option(min=0, help="Another city than the preset's.")] = None,
    format: Annotated[LogFormat, typer.Option(help="Layout of the logs.")] = LogFormat.kitti,
    truth: Annotated[
        bool, typer.Option("--truth", help="Also write depth, class and instance of every pixel, and where everything is.")
    ] = False,
    threads: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; the result does not depend on it.")] = None,
    laps: Annotated[int | None, typer.Option(min=1, max=100_000, help="How often the way of `long` is driven.")] = None,
    drives: Annotated[str | None, typer.Option(help="Only these vehicles: name,name.")] = None,
    frames: Annotated[int | None, typer.Option(min=2, help="Stop each drive after so many frames.")] = None,
) -> None:
    """Draw drives of a synthetic city, with GNSS and exact truth. Called again, a run that was stopped goes on where it ended."""
    from wayloom.pipeline.folders import writing_to
    from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate

    names = tuple(name.strip() for name in drives.split(",") if name.strip()) if drives is not None else ()
    with ProgressBars(quarters=True) as bars, writing_to(out):
        paths = simulate(
            preset,
            out,
            OutputSettings(size.value, format.value, truth),
            PresetVariant(seed, laps, names, frames),
            threads or min(4, os.cpu_count() or 1),
            bars(f"simulating {preset}"),
        )
    for path in paths:
        typer.echo(path)
