"""`wayloom render`: pictures and flights of clouds, processed drives and maps."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.options import FromOption, is_url, known_server
from wayloom.cli.progress_bars import ProgressBars
from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.config.progress import Progress
    from wayloom.exports.source import MapSource
    from wayloom.geodesy.antimeridian import Box
    from wayloom.rendering.scene import Scene

VIEWS = ("top", "oblique", "fly")


def render_command(
    out: Annotated[Path, typer.Option(help="A .png, .jpg or .webp; of a flight a .mp4, .webm, .gif, or a folder for the frames.")],
    where: Annotated[
        list[Path] | None,
        typer.Argument(metavar="IN…", help="A .laz, .las or .ply file, folders of `wayloom process`, or a URL."),
    ] = None,
    server: FromOption = None,
    view: Annotated[str | None, typer.Option(help="top, oblique or fly; default oblique, or fly where --out is a film.")] = None,
    colour: Annotated[str, typer.Option(help="class, height, grey or drives.")] = "class",
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels; of a view from above W is the longer edge.")] = "1920x1080",
    azimuth: Annotated[
        float | None, typer.Option(min=-360.0, max=360.0, help="To which an oblique view looks, degrees from north.")
    ] = None,
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
    folders, url = folders_or_server(where, server)
    with ProgressBars() as bars, writing_to(out.parent):
        scene = _scene(folders, url, city, box, bars("scene"))
        typer.echo(f"{render(scene, look, out, bars(out.name))}: {out}")


def _size(text: str) -> tuple[int, int]:
    """Width and height, even, as video wants them."""
    width, _, height = text.partition("x")
    if not (
        width.isdecimal() and height.isdecimal() and 64 <= min(int(width), int(height)) <= max(int(width), int(height)) <= 8192
    ):
        raise ConfigError(f"--size {text} is no size", remedy="give WxH, 64 to 8192 pixels each, as 1920x1080")
    return int(width) // 2 * 2, int(height) // 2 * 2


def _scene(where: list[Path], url: str | None, city: str, box: "Box | None", progress: "Progress") -> "Scene":
    from wayloom.exports.cloud_files import SUFFIXES
    from wayloom.rendering.scene import scene_of_file, scene_of_map

    if len(where) == 1 and where[0].suffix in SUFFIXES:
        return scene_of_file(where[0])
    return scene_of_map(map_source(where, url, city, box), box, progress)


def folders_or_server(where: list[Path] | None, server: str | None) -> tuple[list[Path], str | None]:
    """What is given as IN…, or the address of a service: of IN…, of --from or of WAYLOOM_SERVER. Raises ConfigError."""
    where = where or []
    if where and not is_url(str(where[0])):
        if server is not None:
            raise ConfigError(f"{where[0]} and --from {server} are two maps", remedy="leave one of the two out")
        return where, None
    url = known_server(*(_url_of_path(path) for path in where), server)
    if url is None:
        raise ConfigError("nothing to show is named", remedy="give a folder of `wayloom process`, or --from URL")
    return [], url


def _url_of_path(path: Path) -> str:
    """A URL that has become a path, and lost one of its two strokes."""
    scheme, _, rest = str(path).partition(":")
    return f"{scheme}://{rest.lstrip('/')}"


def map_source(where: list[Path], url: str | None, city: str, box: "Box | None") -> "MapSource":
    """The map of a service, or of folders of `wayloom process`."""
    from wayloom.client.api import Api
    from wayloom.client.served_map import ServedMap
    from wayloom.exports.drive_outputs import DriveOutputs
    from wayloom.pipeline.settings import load_settings
    from wayloom.stitching.settings import MergeSettings

    if url is None:
        return DriveOutputs(where, MergeSettings(), box)
    return ServedMap(Api(url, load_settings(None).settings.api_key), city, None, box)
