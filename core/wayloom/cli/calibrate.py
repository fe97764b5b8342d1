"""`wayloom calibrate`: a rig's relative lens from several of its drives."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json, words

if TYPE_CHECKING:
    from wayloom.calibration.learn import Calibration
    from wayloom.odometry.rig.calibration_observations import CalibrationObservations

IN_STAGES = Path("stages", "odometry", "evidence.npz")


def calibrate_command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG…",
            help="Drive logs; files of calibration observations; folders of them; folders that `wayloom process` made.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Where the rig's file goes: a RIG.toml.")],
    rig: Annotated[Path | None, typer.Option(help="What is known of the rig already; the drives are added to it.")] = None,
    threads: Annotated[int, typer.Option(min=1, help="More than one: decode ahead. The result is the same.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Learn how the right camera of a rig differs from the ideal one. Logs are tracked first; observations are used as they are."""
    from wayloom.calibration.learn import learn_rig
    from wayloom.calibration.report import facts, lines
    from wayloom.calibration.rig_file import read_rig_file, write_rig_file
    from wayloom.files.atomic import check_writable
    from wayloom.pipeline.folders import writing_to
    from wayloom.pipeline.rig_learning import receivers_of, with_receivers

    known = None if rig is None else read_rig_file(rig)
    with writing_to(out):
        check_writable(out)
        drives = [(source, drive) for source in sources for drive in observations_of(source, threads, (out,))]
        calibration = learn_rig([drive for _, drive in drives], known=known)
        told = [one for source, drive in drives for one in receivers_of(source / IN_STAGES.parts[0], drive.name)]
        write_rig_file(with_receivers(calibration, (*calibration.rig.receivers, *told)), out)
    warn(calibration)
    say = words(as_json)
    for line in lines(calibration):
        say(line)
    say(f"written: {out}")
    if as_json:
        print_json(facts(calibration))


def observations_of(source: Path, threads: int, outputs: tuple[Path | None, ...]) -> "Iterator[CalibrationObservations]":
    """The calibration observations that a path holds, or that its drive gives when it is tracked. Raises InputError."""
    from wayloom.odometry.rig.calibration_file import is_observations_file, load_observations

    if is_observations_file(source):
        yield load_observations(source)
    elif (source / IN_STAGES).is_file():
        yield load_observations(source / IN_STAGES)
    elif files := [file for file in sorted(source.glob("*.npz")) if is_observations_file(file)]:
        for file in files:
            yield load_observations(file)
    else:
        yield _track(source, threads, outputs)


def _track(path: Path, threads: int, outputs: tuple[Path | None, ...]) -> "CalibrationObservations":
    """Track a drive log for its observations alone."""
    from wayloom.logs.registry import check_outside, open_log
    from wayloom.odometry.odometry import track
    from wayloom.odometry.rig.calibration_observations import ObservationCollector

    log = open_log(path)
    check_outside(log, *outputs)
    collector = ObservationCollector(log.rig)
    with ProgressBars(quarters=True) as bars:
        track(log, progress=bars(f"tracking {log.name}"), threads=threads, observers=(collector,))
    return collector.observations(log)


def warn(calibration: "Calibration") -> None:
    """What the user should know beside the result, on stderr."""
    from wayloom.calibration.report import warnings

    for warning in warnings(calibration):
        sys.stderr.write(f"wayloom: warning: {warning}\n")
