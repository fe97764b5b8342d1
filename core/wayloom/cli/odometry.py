"""`wayloom odometry`: the trajectory of a drive, and its cloud of points."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.options import ConfigOption
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json, words

if TYPE_CHECKING:
    from wayloom.odometry.types import OdometryResult

VOID = 255


class TrajectoryFormat(StrEnum):
    """Trajectory files that can be written."""

    TUM = "tum"
    KITTI = "kitti"


def odometry_command(
    log: Annotated[Path, typer.Argument(help="The drive log: KITTI odometry, KITTI raw, KITTI-360, EuRoC, or .mcap.")],
    out: Annotated[Path, typer.Option(help="Where the trajectory goes: one line for every frame.")],
    format: Annotated[TrajectoryFormat, typer.Option(help="Of the trajectory.")] = TrajectoryFormat.TUM,
    points: Annotated[
        Path | None, typer.Option(help="Also write the cloud, in the first camera's frame, to this PLY file.")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, max=64, help="More than one: decode ahead. The result is the same. [default: 1]")
    ] = None,
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept elsewhere; the odometry does not use it.")] = None,
    rig: Annotated[Path | None, typer.Option(help="What `wayloom calibrate` learnt of the rig: a RIG.toml.")] = None,
    evidence: Annotated[
        Path | None, typer.Option(help="Also write what the drive knows of its rig, for `wayloom calibrate`.")
    ] = None,
    debug: Annotated[
        Path | None, typer.Option(help="Also write into this folder what decided each frame: tables, pictures, plots.")
    ] = None,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Track a drive by its stereo pairs, and its IMU if it has one. Exit status 0 with a warning where parts of it were lost."""
    from wayloom.calibration.rig_file import rig_for_log
    from wayloom.calibration.self_calibration import track_calibrated
    from wayloom.config.sources import Option
    from wayloom.errors import ConfigError
    from wayloom.files.atomic import check_writable
    from wayloom.logs.registry import check_outside, open_log
    from wayloom.odometry.debugging.recorder import DebugRecorder
    from wayloom.odometry.rig.calibration_file import save_observations
    from wayloom.odometry.rig.calibration_observations import ObservationCollector
    from wayloom.pipeline.folders import writing_to
    from wayloom.pipeline.settings import load_settings
    from wayloom.pipeline.usable import check_rig
    from wayloom.reports.drive_warnings import calibration_warning

    loaded = load_settings(config, Option("--threads", "threads", threads), Option("--rig", "rig", rig))
    check_rig(loaded)
    settings = loaded.settings
    drive = open_log(log, gnss=gnss)
    check_outside(drive, out, points, evidence, debug)
    known, doubts = rig_for_log(settings.rig, drive)
    for doubt in doubts:
        sys.stderr.write(f"wayloom: warning: {doubt}\n")
    collector = None if evidence is None else ObservationCollector(drive.rig)
    with writing_to(out):
        for file in filter(None, (out, points, evidence)):
            check_writable(file)
        if points is not None and points.suffix.lower() != ".ply":
            raise ConfigError(f"{points}: the cloud is written as PLY", record="--points", remedy="give a name that ends in .ply")
        observers = [observer for observer in (collector, None if debug is None else DebugRecorder(debug)) if observer is not None]
        with ProgressBars(quarters=True) as bars:
            result = track_calibrated(drive, settings.odometry, bars("odometry"), settings.threads, observers=observers, rig=known)
        write_results(result, out, format, points)
        if collector is not None and evidence is not None:
            save_observations(collector.observations(drive), evidence)
    warn_of_losses(result.report)
    if off := calibration_warning(result.report):
        sys.stderr.write(f"wayloom: warning: {off}\n")
    words(as_json)(f"{result.report['tracked']} of {len(drive)} frames tracked, {result.report['keyframes']} keyframes: {out}")
    if as_json:
        print_json(result.report)


def write_results(result: "OdometryResult", out: Path, trajectory_format: TrajectoryFormat, points: Path | None) -> None:
    """Trajectory and cloud, each whole or not at all."""
    import numpy as np

    from wayloom.files.ply import write_ply
    from wayloom.files.trajectory_files import write_kitti, write_tum

    trajectory = result.trajectory
    if trajectory_format is TrajectoryFormat.TUM:
        write_tum(out, trajectory.t_ns, trajectory.T_world_cam, trajectory.tracked)
    else:
        write_kitti(out, trajectory.T_world_cam)
    if points is not None:
        grey = np.repeat(result.points.grey[:, None], 3, axis=1)
        write_ply(points, result.points_world(), grey, np.full(len(grey), VOID, np.uint8), ("frame world: the first left camera",))


def warn_of_losses(report: dict[str, Any]) -> None:
    """One line on stderr where frames were not tracked or the drive fell into segments. report : the odometry's."""
    lost, segments = report["frames"] - report["tracked"], len(report["segments"])
    if lost or segments != 1:
        first = f", the first: frame {report['losses'][0]['frame']}, {report['losses'][0]['reason']}" if report["losses"] else ""
        sys.stderr.write(f"wayloom: warning: {lost} of {report['frames']} frames not tracked, {segments} segments{first}\n")
