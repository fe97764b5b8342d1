"""`wayloom process`: one drive to a labelled, geo-referenced map, without a service."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.pipeline.drive import DriveProgress, DriveResult
    from wayloom.pipeline.settings import ProcessSettings


def process_command(
    log: Annotated[Path, typer.Argument(help="The drive log: KITTI odometry, KITTI raw, KITTI-360, or .mcap.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; what an earlier run finished there is used again.")],
    model: Annotated[
        str | None, typer.Option(envvar="WAYLOOM_MODEL", help="Network: a name of `wayloom models`, or a TOML or ONNX file.")
    ] = None,
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept elsewhere: a KITTI …_sync folder or a gnss.csv.")] = None,
    rig: Annotated[
        Path | None, typer.Option(help="What `wayloom calibrate` learnt of the rig: a RIG.toml, or a folder of them.")
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; default all cores.")] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="LON,LAT,H", help="Origin of the map frame; default the centre of the degree cell.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print report.json on standard output.")] = False,
) -> None:
    """Track, segment, label, geo-reference: trajectory, cloud, overlays, map picture and report of one drive."""
    from wayloom.pipeline.drive import process_drive
    from wayloom.reports.drive_report import JSON_FILE, write_report
    from wayloom.reports.facts import warnings

    settings = settings_from(model, threads, origin, rig)
    with shown_progress() as progress:
        result = process_drive(log, out, settings, gnss, progress, write_report)
    for warning in warnings(result):
        sys.stderr.write(f"wayloom: warning: {warning}\n")
    if json:
        typer.echo((out / JSON_FILE).read_text(), nl=False)
    else:
        typer.echo(summary(result, out))


def settings_from(model: str | None, threads: int | None, origin: str | None, rig: Path | None = None) -> "ProcessSettings":
    """The settings of a run. Raises ConfigError that names the option."""
    from pydantic import ValidationError

    from wayloom.pipeline.settings import ProcessSettings

    remedy = "give LON,LAT,HEIGHT: degrees, degrees, ellipsoidal metres"
    try:
        place = None if origin is None else tuple(float(part) for part in origin.split(","))
        known = None if rig is None else str(rig)
        return ProcessSettings.model_validate(
            {"model": model, "threads": threads or default_threads(), "map_origin": place, "rig": known}
        )
    except ValidationError as problem:
        raise ConfigError(problem.errors(include_url=False)[0]["msg"], record="--origin", remedy=remedy) from None
    except ValueError:
        raise ConfigError(f"{origin!r} is no place", record="--origin", remedy=remedy) from None


def default_threads() -> int:
    """The cores that this process may use."""
    return min(64, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


class shown_progress:  # noqa: N801  used as a context manager
    """A line a stage on standard error: bars on a terminal, one line at the end of each stage elsewhere."""

    def __enter__(self) -> "DriveProgress":
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

        console = Console(file=sys.stderr)
        columns = (
            TextColumn("{task.fields[stage]:13}"),
            BarColumn(28),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
        )
        self.bars = Progress(
            *columns, TextColumn("{task.description}", style="dim"), console=console, disable=not console.is_terminal
        )
        tasks: dict[str, TaskID] = {}
        self.bars.start()

        def show(stage: str, share: float, what: str, /) -> None:
            if stage not in tasks:
                tasks[stage] = self.bars.add_task(what, total=1.0, stage=stage)
            self.bars.update(tasks[stage], completed=share, description=what)
            if share >= 1.0:
                self.bars.stop_task(tasks[stage])
                if not console.is_terminal and what.startswith("done"):
                    sys.stderr.write(f"{stage}: {what}\n")

        return show

    def __exit__(self, *_: object) -> None:
        self.bars.stop()


def summary(result: "DriveResult", out: Path) -> str:
    """What was made, in a few lines."""
    from wayloom.evaluation.trajectory import path_length

    trajectory = result.odometry.trajectory
    tracked = f"{int(trajectory.tracked.sum())} of {len(trajectory)} frames tracked"
    points = sum(len(placed.submap) for placed in result.submaps)
    where = "in its own frame (no GNSS)" if result.geo.frame is None else "geo-referenced"
    distance = path_length(trajectory.T_world_cam[:, :3, 3])
    made = f"{points} labelled points in {len(result.submaps)} submaps, {where}"
    return f"{distance:.1f} m driven, {tracked}, {made}\nreport: {out / 'report.html'}"
