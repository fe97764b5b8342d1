"""`wayloom sync`: a folder kept equal to a map; only what has changed travels."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.options import ConfigOption, FromOption, server_and_last
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json, words

if TYPE_CHECKING:
    from wayloom.client.map_sync import SyncReport

STRAYS_TOLD = 5


def sync_command(
    places: Annotated[
        list[str],
        typer.Argument(metavar="[URL] DIR", help="Folder of static XYZ tiles, made where there is none; before it the service."),
    ],
    server: FromOption = None,
    map_id: Annotated[str, typer.Option("--map", help="Name of the map.")] = "city",
    layers: Annotated[str | None, typer.Option(help="Only these layers of tiles, between commas.")] = None,
    bbox: Annotated[str | None, typer.Option(help="Only tiles that touch west,south,east,north (degrees).")] = None,
    delete: Annotated[bool, typer.Option("--delete", help="Delete files in DIR that are not of the map.")] = False,
    check: Annotated[bool, typer.Option("--check", help="Read every file, also those that look unchanged.")] = False,
    connections: Annotated[int, typer.Option(min=1, max=32, help="Tiles fetched at once.")] = 8,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Make DIR equal to the newest version of a map. Run it again after any interruption, or to follow the map: only what DIR lacks
    is fetched."""
    from wayloom.client.api import Api
    from wayloom.client.map_sync import SyncChoice, SyncOptions, sync_map
    from wayloom.pipeline.settings import load_settings

    url, folder = server_and_last(places, "DIR", server)
    choice = SyncChoice(map_id, tuple(layers.split(",")) if layers else (), None if bbox is None else box_of_option(bbox))
    options = SyncOptions(delete, check, connections)
    key = load_settings(config).settings.api_key
    with Api(url, key, connections) as api, ProgressBars() as bars:
        report = sync_map(api, Path(folder), choice, options, bars(f"map {map_id}"))
    say = words(as_json)
    for line in lines(report, map_id, delete):
        say(line)
    if as_json:
        print_json(asdict(report))


def box_of_option(text: str) -> tuple[float, float, float, float]:
    """West, south, east, north; across the antimeridian west is over east. Raises InputError."""
    from wayloom.exports.boxes import parse_box

    parse_box(text)
    west, south, east, north = (float(part) for part in text.split(","))
    return west, south, east, north


def lines(report: "SyncReport", map_id: str, deleted: bool) -> list[str]:
    """What was done, in words."""
    changes = f"{report.added} new, {report.replaced} changed, {report.dropped} gone, {report.kept} as before"
    moved = f"{report.fetched_files} files, {report.fetched_bytes / 1e6:.2f} MB fetched"
    told = [f"version {report.version} of map {map_id}: {changes}; {moved}"]
    if report.strays:
        fate = ", deleted" if deleted else " (--delete deletes them)"
        some = ", ".join(report.strays[:STRAYS_TOLD]) + (", …" if len(report.strays) > STRAYS_TOLD else "")
        told.append(f"{len(report.strays)} files are not of the map{fate}: {some}")
    return told
