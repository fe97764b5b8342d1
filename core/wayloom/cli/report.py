"""`wayloom report`: a map as one page for people."""

from pathlib import Path
from typing import Annotated

import typer

from wayloom.cli.options import FromOption
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.render import folders_or_server, map_source
from wayloom.errors import UnknownFormatError


def report_command(
    out: Annotated[Path, typer.Option(help="The .html file.")],
    where: Annotated[
        list[Path] | None, typer.Argument(metavar="IN…", help="Folders of `wayloom process`, or the URL of a service.")
    ] = None,
    server: FromOption = None,
    title: Annotated[str | None, typer.Option(help="Its heading; default the map's name, or that of the only drive.")] = None,
    bbox: Annotated[str | None, typer.Option(metavar="W,S,E,N", help="Cut the map to a box of degrees.")] = None,
    city: Annotated[str, typer.Option("--map", help="Which map of a service.")] = "city",
) -> None:
    """Write a page of a map: overview, its cloud raw, with classes and from the street, drives, classes, objects."""
    from wayloom.exports.boxes import parse_box
    from wayloom.pipeline.folders import writing_to
    from wayloom.reports.map_report import write_map_report

    if out.suffix != ".html":
        raise UnknownFormatError(f"{out.suffix or 'a folder'} is no page", file=out, remedy="give a .html")
    box = None if bbox is None else parse_box(bbox)
    folders, url = folders_or_server(where, server)
    heading = title or (folders[0].resolve().name if len(folders) == 1 and folders[0].is_dir() else city)
    with ProgressBars() as bars, writing_to(out.parent):
        told = write_map_report(map_source(folders, url, city, box), out, heading, box, bars(out.name))
        typer.echo(f"{told}: {out}")
