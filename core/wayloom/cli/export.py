"""`wayloom export`: a map, or outputs of drives, in the formats that other programs open."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.options import FromOption, known_server
from wayloom.cli.progress_bars import ProgressBars
from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.exports.source import MapSource
    from wayloom.geodesy.antimeridian import Box


def export_command(
    out: Annotated[Path, typer.Option(help="File or folder to write; its ending tells the format.")],
    folders: Annotated[
        list[Path] | None, typer.Argument(help="Folders that `wayloom process` wrote, or folders of submaps.")
    ] = None,
    form: Annotated[str | None, typer.Option("--format", help="Which of docs/exports.md, such as laz, gpkg, mcap.")] = None,
    bbox: Annotated[str | None, typer.Option(metavar="W,S,E,N", help="Cut to a box of degrees.")] = None,
    layers: Annotated[
        str | None, typer.Option(help="Layers, with commas between them; which there are depends on the format.")
    ] = None,
    voxel: Annotated[float, typer.Option(min=0.01, max=10.0, help="Edge of a voxel of merged drives, m.")] = 0.1,
    geoid: Annotated[Path | None, typer.Option(help="Geoid grid (.gtx, .tif): LAZ and COPC state heights above it.")] = None,
    server: FromOption = None,
    city: Annotated[str, typer.Option("--map", help="Which map of the service.")] = "city",
    version: Annotated[int | None, typer.Option(min=1, help="Which version of it; default the newest.")] = None,
) -> None:
    """Write a map, of the outputs of `wayloom process` or of a service, in a format that other programs open."""
    from wayloom.exports.boxes import nothing_inside, parse_box
    from wayloom.exports.formats import Export, checked_format, export_map
    from wayloom.geodesy.geoid import GeoidGrid
    from wayloom.pipeline.folders import writing_to

    wanted = () if layers is None else tuple(name.strip() for name in layers.split(","))
    checked_format(out, form, wanted, geoid is not None)
    server = server if folders else known_server(server)
    if bool(folders) == (server is not None):
        raise ConfigError("give folders of drives, or --from URL", remedy="wayloom export DRIVE… --out map.laz")
    box = None if bbox is None else parse_box(bbox)
    grid = None if geoid is None else GeoidGrid(geoid)
    with ProgressBars() as bars, writing_to(out.parent):
        source = _of_drives(folders or [], voxel, box) if server is None else _of_server(server, city, version, box)
        if box is not None and not source.keys:
            raise nothing_inside(out)
        typer.echo(f"{export_map(Export(source, out, box, wanted, grid, bars(out.name)), form)}: {out}")


def _of_drives(folders: list[Path], voxel_m: float, box: "Box | None") -> "MapSource":
    from wayloom.exports.drive_outputs import DriveOutputs
    from wayloom.pipeline.code_version import code_version
    from wayloom.stitching.settings import MergeSettings

    return DriveOutputs(folders, MergeSettings(voxel_m=voxel_m), box, code_version("wayloom.stitching.merge").text)


def _of_server(url: str, city: str, version: int | None, box: "Box | None") -> "MapSource":
    from wayloom.client.api import Api
    from wayloom.client.served_map import ServedMap
    from wayloom.pipeline.settings import load_settings

    return ServedMap(Api(url, load_settings(None).settings.api_key), city, version, box)
