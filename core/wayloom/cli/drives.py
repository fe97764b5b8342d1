"""`wayloom drives`: what an operator does with the drives of a service, from the command line."""

import json
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from wayloom.cli.options import ConfigOption, ToOption
from wayloom.cli.results import JsonOption, print_json, words
from wayloom.config.drive_states import DriveState
from wayloom.errors import ConfigError, NotFoundError

if TYPE_CHECKING:
    from wayloom.client.api import Api

group = typer.Typer(
    help="The drives of a service: list, show, watch, retry, cancel, delete, report, download.", no_args_is_help=True
)
DriveArgument = Annotated[str, typer.Argument(metavar="DRIVE", help="The drive's id, or its beginning; or its name.")]
SHORT: Final = 12
"""Digits of an id that people are shown."""


@group.command("list")
def list_command(
    to: ToOption,
    state: Annotated[DriveState | None, typer.Option(help="Only drives of this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=500, help="How many, newest first.")] = 100,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """The newest drives: id, state, grade, progress, name."""
    wanted = {"limit": limit} | ({} if state is None else {"state": state})
    with service(to, config) as api:
        found = api.json("GET", "/v1/drives", params=wanted)
    if as_json:
        print_json(found)
        return
    for drive in found["drives"]:
        typer.echo(line(drive))
    if not found["drives"]:
        typer.echo("no drives" if state is None else f"no drive is {state}")


@group.command("show")
def show_command(drive: DriveArgument, to: ToOption, as_json: JsonOption = False, config: ConfigOption = None) -> None:
    """One drive: what it is, how far each stage is, its grade and the reasons for it."""
    with service(to, config) as api:
        found = find(api, drive)
    if as_json:
        print_json(found)
        return
    for text in lines(found):
        typer.echo(text)


@group.command("watch")
def watch_command(drive: DriveArgument, to: ToOption, as_json: JsonOption = False, config: ConfigOption = None) -> None:
    """Follow a drive's stages until it is in the map, held or failed; of an upload that was not waited for, too."""
    from wayloom.cli.progress_bars import ProgressBars
    from wayloom.client.watch import wait_for_drive

    with service(to, config) as api, ProgressBars(elsewhere=True) as bars:
        found = find(api, drive)
        before = {stage["stage"] for stage in found["stages"] if stage["state"] == "done"}
        ended = wait_for_drive(api, found["id"], lambda stage: bars(f"{found['name']}, {stage}"), before)
    _tell(ended, as_json)
    if ended["state"] == "failed":
        words(as_json)(f"  {ended['error']}")
        raise typer.Exit(1)


@group.command("retry")
def retry_command(
    drive: DriveArgument,
    to: ToOption,
    stage: Annotated[str | None, typer.Option(help="Make this stage and those after it anew; else the one that failed.")] = None,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Try the failed stage of a drive again, with a fresh set of attempts, or begin at a stage; those before it are kept."""
    wanted = {} if stage is None else {"json": {"stage": stage}}
    with service(to, config) as api:
        _tell(api.json("POST", f"/v1/drives/{find(api, drive)['id']}/retry", **wanted), as_json)


@group.command("cancel")
def cancel_command(drive: DriveArgument, to: ToOption, as_json: JsonOption = False, config: ConfigOption = None) -> None:
    """Stop the stages of a drive: it fails as cancelled, and `retry` goes on with it."""
    with service(to, config) as api:
        _tell(api.json("POST", f"/v1/drives/{find(api, drive)['id']}/cancel"), as_json)


@group.command("delete")
def delete_command(
    drive: DriveArgument,
    to: ToOption,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Remove a drive for good: its files at once, its part of the map with the next version."""
    with service(to, config) as api:
        found = find(api, drive)
        if not yes:
            confirm(f"remove {found['name']} ({found['id'][:SHORT]}) and its part of the map for good?")
        _tell(api.json("DELETE", f"/v1/drives/{found['id']}"), as_json)


@group.command("report")
def report_command(
    drive: DriveArgument,
    to: ToOption,
    out: Annotated[Path, typer.Option(help="File to write: .html is one page with its pictures, .json the numbers.")],
    config: ConfigOption = None,
) -> None:
    """Write a drive's quality report: grade with reasons, GNSS residuals, drift, loops, uncertainty along the road."""
    from wayloom.files.atomic import write_atomically
    from wayloom.reports.served_drive import render

    if out.suffix not in (".html", ".json"):
        raise ConfigError(f"{out.name} is no report", remedy="name a file that ends in .html or .json")
    with service(to, config) as api:
        found = find(api, drive)
        quality = api.json("GET", f"/v1/drives/{found['id']}/quality")
        if out.suffix == ".json":
            content = json.dumps({"drive": found, "quality": quality}, indent=1) + "\n"
        else:
            address = f"/v1/drives/{found['id']}/quality"
            content = render(found, quality, {name: api.once("GET", f"{address}/{name}.svg").text for name in quality["pictures"]})
    write_atomically(out, content.encode())
    typer.echo(f"written: {out}")


@group.command("download")
def download_command(
    drive: DriveArgument,
    to: ToOption,
    out: Annotated[Path, typer.Option(help="File to write, a .zip.")],
    config: ConfigOption = None,
) -> None:
    """Write all that a drive has led to as one zip: poses, track, points, objects, ground, report; README.txt in it explains it."""
    from wayloom.cli.progress_bars import ProgressBars
    from wayloom.client.drives import download_archive

    if out.suffix != ".zip":
        raise ConfigError(f"{out.name} is no archive", remedy="name a file that ends in .zip")
    with service(to, config) as api, ProgressBars() as bars:
        found = find(api, drive)
        download_archive(api, found["id"], out, bars(found["name"]))
    typer.echo(f"written: {out}")


def _tell(drive: dict[str, Any], as_json: bool) -> None:
    """What the service says of a drive, as a line or whole."""
    if as_json:
        print_json(drive)
    else:
        typer.echo(line(drive))


def service(url: str, config: Path | None) -> "Api":
    """The service, with the key of the settings."""
    from wayloom.client.api import Api
    from wayloom.pipeline.settings import load_settings

    return Api(url, load_settings(config).settings.api_key)


def find(api: "Api", wanted: str) -> dict[str, Any]:
    """The one drive whose id begins so, or that is called so. Raises NotFoundError where there is none, or more than one."""
    from wayloom.client.drives import all_drives

    found = [one for one in all_drives(api) if one["id"].startswith(wanted) or one["name"] == wanted]
    if len(found) != 1:
        which = ", ".join(f"{one['name']} ({one['id'][:SHORT]})" for one in found[:3]) + (", …" if len(found) > 3 else "")
        said = f"{len(found)} drives are called {wanted!r}: {which}" if found else f"no drive is called {wanted!r}"
        how = "; give an id or its beginning: " if found else "; "
        raise NotFoundError(f"{said}{how}`wayloom drives list --to {api.url}` shows them")
    return found[0]


def confirm(question: str) -> None:
    """Ask on the terminal. Raises ConfigError where nobody can answer, and ends where the answer is no."""
    if not sys.stdin.isatty():
        raise ConfigError("nobody is there to be asked", remedy="say --yes")
    if not typer.confirm(question):
        raise typer.Exit(1)


def line(drive: dict[str, Any]) -> str:
    """A drive in one line."""
    grade = (drive["quality"] or {}).get("grade") or "-"
    running = drive["state"] in ("uploading", "queued", "running", "stitching")
    share = f" {100.0 * drive['progress']:3.0f} %{rest(drive['eta_s'])}" if running else ""
    note = f"  {drive['error'] or drive['note']}" if drive["error"] or drive["note"] else ""
    return f"{drive['id'][:SHORT]}  {drive['state']:<11}{share} {grade}  {drive['name']}{note}"


def rest(eta_s: float | None) -> str:
    """How long it takes yet, in words; nothing where that is not known."""
    if eta_s is None:
        return ""
    return f", {eta_s:.0f} s left" if eta_s < 120.0 else f", {eta_s / 60.0:.0f} min left"


def lines(drive: dict[str, Any]) -> list[str]:
    """A drive in full."""
    out = [line(drive), f"  id {drive['id']}", f"  vehicle {drive['vehicle_id'] or '-'}, map {drive['map_id']}"]
    out.append(f"  {drive['received_files']} of {drive['files']} files, {drive['received_bytes']} of {drive['bytes']} bytes")
    if drive["images"]["state"] != "kept":
        since = datetime.fromtimestamp(drive["images"]["since"] or 0.0).astimezone()
        out.append(f"  images {drive['images']['state']} since {since:%Y-%m-%d %H:%M}")
    for stage in drive["stages"]:
        seconds = "" if stage["seconds"] is None else f" {stage['seconds']:.1f} s"
        words = stage["error"] or (stage["message"] if stage["state"] == "running" else "")
        out.append(
            f"  {stage['stage']:<13}{stage['state']:<8}{100.0 * stage['progress']:3.0f} %{seconds}{f'  {words}' if words else ''}"
        )
    quality = drive["quality"]
    if quality:
        out.append(f"  grade {quality['grade'] or '-'}, {quality['gate']}")
        out += [f"    {reason}" for reason in quality["reasons"]]
        out += [f"    by the map: {quality['by_map']['reason']}"] if quality["by_map"] else []
        out += [f"    released by {quality['release']['by']}: {quality['release']['why']}"] if quality["release"] else []
    return out
