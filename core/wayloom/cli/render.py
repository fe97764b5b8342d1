"""`wayloom render`: pictures and flights of clouds, processed drives and maps."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.progress_bars import ProgressBars
from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.config.progress import Progress
    from wayloom.exports.source import MapSource
    from wayloom.geodesy.antimeridian import Box
    from wayloom.rendering.scene import Scene

VIEWS = ("top", "oblique", "fly")


def render_command(
    where: Annotated[
        list[Path],
        typer.Argument(metavar="IN…", help="A .laz, .las or .ply file, folders of `wayloom process`, or a URL."),
    ],
    out: Annotated[Path, typer.Option(help="A .png, .jpg or .webp; of a flight a .mp4, .webm, .gif, or a folder for the frames.")],
    view: Annotated[str | None, typer.Option(help="top, oblique or fly; default oblique, or fly where --out is a film.")] = None,
    colour: Annotated[str, typer.Option(help="class, height, grey or drives.")] = "class",
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels; of a view from above W is the longer edge.")] = "1920x1080",
    azimuth: Annotated[float | None, typer.Option(help="To which an oblique view looks, degrees from north.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, max=600.0, help="Length of a flight.")] = None,
    tracks: Annotated[bool, typer.Option(help="Draw the drives' ways.")] = True,
    legend: Annotated[bool, typer.Option(help="Draw legend and scale.")] = True,
    bbox: Annotated[str | None, typer.Option(metavar="W,S,E,N", help="Cut a map to a box of degrees.")] = None,
    city: Annotated[str, typer.Option("--map", help="Which map of a service.")] = "city",
) -> None:
    """Draw a cloud, drives or a map: from above, from one side, or as a flight along the longest drive."""
    from wayloom.exports.boxes import parse_box
    from wayloom.pipeline.folders import writing_to
    from wayloom.rendering.render import Look, check_look, render

    width, height = _size(size)
    chosen = view or ("fly" if out.suffix in (".mp4", ".webm", ".gif", "") else "oblique")
    if chosen not in VIEWS:
        raise ConfigError(f"--view {chosen} is not known", remedy=f"known are {', '.join(VIEWS)}")
    look = Look(chosen, colour, width, height, azimuth, seconds, tracks, legend)  # type: ignore[arg-type]
    check_look(look, out)
    box = None if bbox is None else parse_box(bbox)
    with ProgressBars() as bars, writing_to(out.parent):
        scene = _scene(where, city, box, bars("scene"))
        typer.echo(f"{render(scene, look, out, bars(out.name))}: {out}")


def _size(text: str) -> tuple[int, int]:
    """Width and height, even, as video wants them."""
    width, _, height = text.partition("x")
    if not (
        width.isdecimal() and height.isdecimal() and 64 <= min(int(width), int(height)) <= max(int(width), int(height)) <= 8192
    ):
        raise ConfigError(f"--size {text} is no size", remedy="give WxH, 64 to 8192 pixels each, as 1920x1080")
    return int(width) // 2 * 2, int(height) // 2 * 2


def _scene(where: list[Path], city: str, box: "Box | None", progress: "Progress") -> "Scene":
    from wayloom.exports.cloud_files import SUFFIXES
    from wayloom.rendering.scene import scene_of_file, scene_of_map

    if len(where) == 1 and where[0].suffix in SUFFIXES:
        return scene_of_file(where[0])
    return scene_of_map(map_source(where, city, box), box, progress)


def map_source(where: list[Path], city: str, box: "Box | None") -> "MapSource":
    """The map of a service, whose URL has become a path, or of folders of `wayloom process`."""
    from wayloom.exports.drive_outputs import DriveOutputs
    from wayloom.stitching.settings import MergeSettings

    first = str(where[0])
    if first.startswith(("http:", "https:")):  # a path has lost one of the two strokes
        return _served(first, city, box)
    return DriveOutputs(where, MergeSettings(), box)


def _served(path: str, city: str, box: "Box | None") -> "MapSource":
    from wayloom.client.api import Api
    from wayloom.client.served_map import ServedMap
    from wayloom.pipeline.settings import load_settings

    scheme, _, rest = path.partition(":")
    return ServedMap(Api(f"{scheme}://{rest.lstrip('/')}", load_settings(None).settings.api_key), city, None, box)
