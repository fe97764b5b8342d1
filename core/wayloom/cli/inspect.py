"""`wayloom inspect`: what is in a log, and what is wrong with it."""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.results import JsonOption, print_json

if TYPE_CHECKING:
    from wayloom.logs.inspection import LogReport, RateReport

SHOWN = 10
PIPE_WIDTH = 200


def inspect_command(
    log: Annotated[
        Path,
        typer.Argument(help="The log: a folder of KITTI odometry, raw or 360, or of EuRoC, or a ROS 2 recording (.mcap)."),
    ],
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept elsewhere: a KITTI …_sync folder or a gnss.csv.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Look at both ends of each image instead of decoding all.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Print what is in a log, what is missing, rates, gaps, duration, distance. Exit status 2 where it cannot be used.

    Images are decoded, and a few pairs matched: --quick does neither.
    """
    from wayloom.errors import CalibrationError, LogError
    from wayloom.logs.inspection import inspect_log
    from wayloom.logs.registry import open_log_unchecked
    from wayloom.odometry.frame_source import first_matches
    from wayloom.odometry.settings import OdometrySettings

    drive = open_log_unchecked(log, gnss=gnss)
    report = inspect_log(drive, decode=not quick)
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        print_report(report)
    if not report.usable:
        count = len(report.damaged)
        raise LogError(f"{count} of {2 * report.frames.count} images cannot be used, the first: {report.damaged[0].problem}")
    if not quick:
        with contextlib.suppress(CalibrationError):  # a rig that cannot be tracked with may yet be converted
            first_matches(drive, OdometrySettings().row_frames)  # raises LogError where the sides are exchanged


def print_report(report: "LogReport") -> None:
    """The report as tables."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=PIPE_WIDTH)
    table = Table("", report.name, title=None, show_header=True, header_style="bold", box=None, pad_edge=False)
    for name, value in rows(report):
        table.add_row(Text(name, style="dim"), Text(value))
    console.print(table, soft_wrap=True)
    for damaged in report.damaged[:SHOWN]:
        console.print(Text(f"damaged: {damaged.problem}", style="red"), soft_wrap=True)
    if len(report.damaged) > SHOWN:
        console.print(Text(f"damaged: {len(report.damaged) - SHOWN} more", style="red"))


def rows(report: "LogReport") -> list[tuple[str, str]]:
    """The report as (name, value) lines."""
    camera, gnss = report.camera, report.gnss
    x, y, z = camera.t_right_left_m
    kind = "colour" if camera.colour else "grey"
    stored = f", rectified on load from {camera.stored_width}x{camera.stored_height}" if camera.rectified_on_load else ""
    out = [
        ("format", report.format),
        ("rig, vehicle", f"{report.rig_id or 'not named'}, {report.vehicle_id or 'not named'}"),
        ("start", report.start),
        ("frames", rate_text(report.frames)),
        ("distance", "unknown" if report.distance_m is None else f"{report.distance_m:.1f} m (from {report.distance_from})"),
        ("images", f"{camera.width}x{camera.height}, {kind}{stored}"),
        ("camera", f"fx {camera.fx:.3f}, fy {camera.fy:.3f}, cx {camera.cx:.3f}, cy {camera.cy:.3f} px"),
        ("baseline", f"{camera.baseline_m:.4f} m (right camera at {-x:.4f}, {0.0 - y:.4f}, {0.0 - z:.4f} m)"),
    ]
    if gnss is not None:
        share = ", ".join(f"{name} {100 * part:.0f} %" for name, part in gnss.share.items() if part > 0)
        lon, lat, height = gnss.first_lon_lat_height
        out += [
            ("GNSS", rate_text(gnss.fixes)),
            ("GNSS fix", f"{share}; sigma {gnss.sigma_median_m:.3f} m, worst {gnss.sigma_worst_m:.3f} m"),
            ("GNSS place", f"{lat:.6f}, {lon:.6f} (lat, lon), height {height:.1f} m"),
            ("GNSS frames", f"{gnss.frames_covered} of {report.frames.count} within its time span"),
            ("lever arm", "{:.3f}, {:.3f}, {:.3f} m (x right, y down, z forward of the left camera)".format(*gnss.p_cam_gnss_m)),
        ]
    if report.imu is not None:
        out.append(("IMU", rate_text(report.imu)))
    if report.p_cam_imu_m is not None:
        out.append(("IMU place", "{:.3f}, {:.3f}, {:.3f} m in the left camera's frame".format(*report.p_cam_imu_m)))
    if report.truth_poses:
        out.append(("truth", f"{report.truth_poses} poses"))
    out.append(("files", f"{report.files}, {report.bytes / 1e6:.1f} MB"))
    out.append(("missing", "; ".join(report.missing) or "nothing"))
    return out


def rate_text(rate: "RateReport") -> str:
    """Count, rate, duration and gaps in words."""
    text = f"{rate.count} at {rate.rate_hz:.2f} Hz, {rate.duration_s:.2f} s"
    if not rate.gaps:
        return text + ", no gaps"
    shown = ", ".join(f"{gap.seconds:.2f} s after {gap.after}" for gap in rate.gaps[:SHOWN])
    more = f", {len(rate.gaps) - SHOWN} more" if len(rate.gaps) > SHOWN else ""
    gaps = "1 gap" if len(rate.gaps) == 1 else f"{len(rate.gaps)} gaps"
    return f"{text}, {gaps}: {shown}{more}"
