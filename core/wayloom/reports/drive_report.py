"""Drive report: report.json for machines, and report.html, one self-contained page for people."""

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE
from wayloom.exports.drive_origin import REPORT_FILE
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.geometry import se3
from wayloom.pipeline.drive_map import PlacedPoints, read_image
from wayloom.pipeline.drive_quality import QUALITY_FILE, write_quality
from wayloom.pipeline.drive_result import DriveResult
from wayloom.pipeline.exports import MAP_FILE, OVERLAYS_DIR
from wayloom.pipeline.plane import T_plane_enu, axis_labels
from wayloom.reports import plots, views
from wayloom.reports.facts import drive_facts
from wayloom.reports.quality_plots import PICTURES, quality_pictures
from wayloom.reports.triple import cloud_views

FloatArray = NDArray[np.float64]
JSON_FILE: Final = REPORT_FILE
HTML_FILE: Final = "report.html"
OVERLAY_WIDTH_PX: Final = 700
MAP_WIDTH_PX: Final = 1400


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the page: a data URI and the words under it."""

    uri: str
    caption: str


def write_report(result: DriveResult, folder: Path) -> None:
    """Write report.html, with the pictures that `write_exports` left in the folder, quality.json and report.json."""
    facts = drive_facts(result)
    write_quality(folder / QUALITY_FILE, result.quality)
    write_atomically(folder / HTML_FILE, render(facts, pictures(result, folder)).encode())
    write_atomically(folder / JSON_FILE, (json.dumps(facts, indent=1, allow_nan=False) + "\n").encode())


def render(facts: dict[str, Any], shown: dict[str, Any]) -> str:
    """The HTML page. facts : report.json's content; shown : what `pictures` returns."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("wayloom.reports"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"number": number, "thousands": thousands}
    return environment.get_template("drive.html.j2").render(
        facts=facts, shown=shown, bars=class_bars(facts), stages=stage_bars(facts)
    )


def pictures(result: DriveResult, folder: Path) -> dict[str, Any]:
    """All drawings and pictures of the page."""
    T = T_plane_enu(result.geo)
    track = se3.transform(T, result.geo.T_enu_cam[:, :3, 3])
    side = views.side_view(PlacedPoints(result.submaps, T), track)
    drawn = quality_pictures(result.quality)
    return {
        "track": Markup(plots.track_svg(track_picture(result, track, T))),  # noqa: S704  drawn here, from numbers
        "quality": {name: Markup(drawn[name]) if name in drawn else None for name in PICTURES},  # noqa: S704  likewise
        "map": Picture(data_uri(views.png_bytes(views.shrunk(read_image(folder / MAP_FILE), MAP_WIDTH_PX)), "png"), ""),
        "side": Picture(data_uri(views.png_bytes(side.image), "png"), f"{side.width_m:.0f} m of road, {side.height_m:.0f} m high"),
        "views": [Picture(data_uri(views.jpeg_bytes(image), "jpeg"), words) for words, image in cloud_views(result).items()],
        "overlays": overlays(result, folder),
    }


def track_picture(result: DriveResult, track: FloatArray, T: FloatArray) -> plots.TrackPicture:
    """The trajectory in the drive's plane, with its fixes and its truth."""
    gnss, frame, trajectory = result.log.gnss, result.geo.frame, result.odometry.trajectory
    fixes = None
    if gnss is not None and frame is not None:
        fixes = se3.transform(T, enu_from_lonlatheight(gnss.lon_lat_height, frame))[:, :2]
    truth = None
    if result.log.truth is not None and np.isfinite(result.log.truth).all(axis=(1, 2)).sum() >= 3:
        truth = plots.aligned_truth(result.log.truth, T @ result.geo.T_enu_cam)[:, :2]
    return plots.TrackPicture(
        track=track[:, :2],
        tracked=trajectory.tracked,
        segment=trajectory.segment,
        fixes=fixes,
        fix_type=None if fixes is None or gnss is None else gnss.fix_type,
        truth=truth,
        labels=axis_labels(result.geo),
        loops=result.quality["loops"],
    )


def overlays(result: DriveResult, folder: Path) -> list[Picture]:
    """Label overlays of each keyframe that was drawn, the left one and where it was labelled the right one."""
    t_ns, shown = result.odometry.trajectory.t_ns, list[Picture]()
    for left in sorted((folder / OVERLAYS_DIR).glob("*_left.jpg")):
        frame = int(left.name.removesuffix("_left.jpg"))
        caption = f"frame {frame}, {(t_ns[frame] - t_ns[0]) * 1e-9:.1f} s"
        right = left.with_name(left.name.replace("_left", "_right"))
        for file, words in ((left, f"{caption}, left"), (right, "right")):
            if file.is_file():
                jpeg = views.jpeg_bytes(views.shrunk(read_image(file), OVERLAY_WIDTH_PX))
                shown.append(Picture(data_uri(jpeg, "jpeg"), words))
    return shown


def class_bars(facts: dict[str, Any]) -> list[dict[str, Any]]:
    """For each class that has a point: name, colour, counts, and the length of its bar in percent of the longest."""
    most = max((counts["tcl_stereo"] for counts in facts["classes"].values()), default=0) or 1
    colours = {name: "#" + PALETTE[i].tobytes().hex() for i, name in enumerate(CLASS_NAMES)}
    rows = []
    for name, counts in facts["classes"].items():
        if any(counts.values()):
            change = counts["tcl_stereo"] - counts["baseline"]
            width = 100.0 * counts["tcl_stereo"] / most
            rows.append({"name": name, "colour": colours.get(name, "#000000"), "width": width, "change": change, **counts})
    return sorted(rows, key=lambda row: (row["name"] == "void", -row["tcl_stereo"], row["name"]))


def stage_bars(facts: dict[str, Any]) -> list[dict[str, Any]]:
    """For each stage: name, seconds, whether reused, and the length of its bar in percent of the longest."""
    longest = max((stage["seconds"] for stage in facts["stages"].values()), default=0.0) or 1.0
    return [{"name": name, "width": 100.0 * stage["seconds"] / longest, **stage} for name, stage in facts["stages"].items()]


def data_uri(data: bytes, kind: str) -> str:
    """An image inside the page."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """A number for people; a dash for None."""
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def thousands(value: int) -> str:
    """1234567 to '1 234 567', with narrow no-break spaces."""
    return f"{value:,}".replace(",", "\u202f")
