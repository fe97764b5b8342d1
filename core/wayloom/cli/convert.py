"""`wayloom convert`: a drive log in another format."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wayloom.cli.progress_bars import ProgressBars


class Target(StrEnum):
    """Formats that are written."""

    kitti = "kitti"
    euroc = "euroc"
    mcap = "mcap"


def convert_command(
    log: Annotated[Path, typer.Argument(help="The drive log, of any format that `wayloom inspect` knows.")],
    to: Annotated[Target, typer.Option(help="KITTI odometry, EuRoC/ASL, or a ROS 2 recording in MCAP.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the new log; default beside the old one.")] = None,
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept elsewhere: a KITTI …_sync folder or a gnss.csv.")] = None,
) -> None:
    """Write a log in another format: images byte for byte where they can stay, and everything that positions them."""
    from wayloom.logs.conversion import convert_log
    from wayloom.logs.registry import check_outside, open_log
    from wayloom.pipeline.folders import writing_to

    drive = open_log(log, gnss=gnss)
    folder = out if out is not None else drive.path.with_name(f"{drive.path.stem}-{to.value}")
    check_outside(drive, folder)
    with ProgressBars() as bars, writing_to(folder):
        done = convert_log(drive, folder, to.value, bars(f"converting {drive.name}"))
    for what in done.left_out:
        sys.stderr.write(f"wayloom: warning: left out: {what}\n")
    typer.echo(f"{done.frames} frames, {done.copied} of them byte for byte: {done.path}")
