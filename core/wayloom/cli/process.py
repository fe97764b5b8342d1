"""`wayloom process`: one drive to a labelled, geo-referenced map, without a service."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.options import ConfigOption, default_threads
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, words

if TYPE_CHECKING:
    from wayloom.pipeline.drive_result import DriveResult


def process_command(
    log: Annotated[Path, typer.Argument(help="The drive log: KITTI odometry, KITTI raw, KITTI-360, EuRoC, or .mcap.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; what an earlier run finished there is used again.")],
    model: Annotated[str | None, typer.Option(help="Network: a name of `wayloom models`, or a TOML or ONNX file.")] = None,
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept elsewhere: a KITTI …_sync folder or a gnss.csv.")] = None,
    rig: Annotated[
        Path | None, typer.Option(help="What `wayloom calibrate` learnt of the rig: a RIG.toml, or a folder of them.")
    ] = None,
    learn_rig: Annotated[
        Path | None, typer.Option(help="A RIG.toml to which this drive is added when it is done; made where there is none.")
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; default all cores.")] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="LON,LAT,H", help="Origin of the map frame; default the centre of the degree cell.")
    ] = None,
    geoid: Annotated[Path | None, typer.Option(help="Geoid grid (.gtx, .tif): cloud.laz states heights above it.")] = None,
    dense: Annotated[
        bool | None,
        typer.Option("--dense", help="Also write dense.laz: points of facades, poles and vegetation in voxels of 10 cm."),
    ] = None,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Track, segment, label, geo-reference: trajectory, cloud, overlays, map picture and report of one drive."""
    from wayloom.config.sources import Option
    from wayloom.files.atomic import check_writable
    from wayloom.pipeline.drive import STAGES_DIR, process_drive
    from wayloom.pipeline.rig_learning import learn_from_drive
    from wayloom.pipeline.settings import load_settings
    from wayloom.pipeline.usable import check_usable
    from wayloom.reports.facts import warnings

    given = (
        Option("--model", "segmentation.model", model), Option("--threads", "threads", threads),
        Option("--origin", "map_origin", origin), Option("--rig", "rig", rig),
        Option("--geoid", "geoid", geoid), Option("--dense", "dense", dense),
    )  # fmt: skip
    loaded = load_settings(config, *given, threads=default_threads())
    check_usable(loaded)
    if learn_rig is not None:
        check_writable(learn_rig)
    with ProgressBars() as progress:
        result = process_drive(log, out, loaded.settings.of_drives(), gnss, progress, _write_report)
    learnt = [] if learn_rig is None else learn_from_drive(out / STAGES_DIR, learn_rig)
    for warning in (*warnings(result), *learnt):
        sys.stderr.write(f"wayloom: warning: {warning}\n")
    words(as_json)(summary(result, out))
    if as_json:
        from wayloom.reports.drive_report import JSON_FILE

        typer.echo((out / JSON_FILE).read_text(), nl=False)


def _write_report(result: "DriveResult", folder: Path) -> None:
    from wayloom.reports.drive_report import write_report  # what plots is loaded beside the exports, not before the drive

    write_report(result, folder)


def summary(result: "DriveResult", out: Path) -> str:
    """What was made, in a few lines."""
    from wayloom.evaluation.trajectory import path_length

    trajectory = result.odometry.trajectory
    tracked = f"{int(trajectory.tracked.sum())} of {len(trajectory)} frames tracked"
    points = sum(len(placed.submap) for placed in result.submaps)
    where = "in its own frame (no GNSS)" if result.geo.frame is None else f"geo-referenced, grade {result.quality['grade']}"
    distance = path_length(trajectory.T_world_cam[:, :3, 3])
    parts = f"{len(result.submaps)} submap{'' if len(result.submaps) == 1 else 's'}"
    made = f"{points} labelled points in {parts}, {where}"
    return f"{distance:.1f} m driven, {tracked}, {made}\nreport: {out / 'report.html'}"
