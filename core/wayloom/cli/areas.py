"""`wayloom areas`: places of which the map of a service keeps nothing."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from wayloom.cli.drives import SHORT, confirm, service
from wayloom.cli.options import ConfigOption, ToOption
from wayloom.cli.results import JsonOption, print_json
from wayloom.errors import InputError, NotFoundError

group = typer.Typer(help="Excluded areas of a service's map: add, list, remove.", no_args_is_help=True)


@group.command("add")
def add_command(
    file: Annotated[Path, typer.Argument(metavar="FILE.geojson", help="Polygons in WGS84; a feature's `name` is kept.")],
    to: ToOption,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Keep nothing of these areas any more, and drop for good what is there."""
    from wayloom.exclusion.areas import areas_of_geojson

    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", file=file, remedy="give a GeoJSON file") from error
    try:
        found = areas_of_geojson(content)
    except InputError as error:
        raise InputError(error.what, file=file, remedy=error.remedy) from error
    if not yes:
        confirm(f"drop all that the map has in {len(found)} areas for good?")
    with service(to, config) as api:
        added = api.json("POST", "/v1/excluded-areas", json=content)
    if as_json:
        print_json(added)
        return
    for area in added["features"]:
        typer.echo(line(area))


@group.command("list")
def list_command(to: ToOption, as_json: JsonOption = False, config: ConfigOption = None) -> None:
    """The areas: id, since which version of the map, name."""
    with service(to, config) as api:
        found = api.json("GET", "/v1/excluded-areas")
    if as_json:
        print_json(found)
        return
    for area in found["features"]:
        typer.echo(line(area))
    if not found["features"]:
        typer.echo("no excluded areas")


@group.command("remove")
def remove_command(
    area: Annotated[str, typer.Argument(metavar="AREA", help="Its id, or the beginning; or its name.")],
    to: ToOption,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Let the map have an area again, of drives that come from now on."""
    with service(to, config) as api:
        areas = api.json("GET", "/v1/excluded-areas")["features"]
        found = [one for one in areas if one["id"].startswith(area) or one["properties"]["name"] == area]
        if len(found) != 1:
            raise NotFoundError(f"{len(found) or 'no'} areas are called {area!r}; `wayloom areas list --to {to}` shows them")
        api.once("DELETE", f"/v1/excluded-areas/{found[0]['id']}")
    if as_json:
        print_json(found[0])
    else:
        typer.echo(f"removed: {line(found[0])}")


def line(area: dict[str, Any]) -> str:
    """An area in one line."""
    about = area["properties"]
    since = "being excluded" if about["since_version"] is None else f"since version {about['since_version']}"
    return f"{area['id'][:SHORT]}  {since:<18} {about['source']:<8}  {about['name'] or '-'}"
