"""`wayloom rigs`: what a service remembers of rigs."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from wayloom.cli.options import ConfigOption, FromOption, server_and_last, server_of
from wayloom.cli.results import JsonOption, print_json, words
from wayloom.errors import NotFoundError

group = typer.Typer(help="What a service remembers of the rigs of its vehicles.", no_args_is_help=True)
Url = Annotated[str | None, typer.Argument(metavar="URL", help="Address of the service.")]


@group.command("list")
def list_command(url: Url = None, server: FromOption = None, as_json: JsonOption = False, config: ConfigOption = None) -> None:
    """Every rig: vehicle, drives, newest version of its file, its GNSS clock."""
    found = fetched(server_of(url, server), config)
    if as_json:
        print_json({"rigs": found})
        return
    for rig in found:
        typer.echo(line(rig))
    if not found:
        typer.echo("no drive has named a rig yet")


@group.command("show")
def show_command(
    which: Annotated[
        list[str],
        typer.Argument(metavar="[URL] RIG", help="The rig's id, or its beginning; or its vehicle's id; before it the service."),
    ],
    server: FromOption = None,
    out: Annotated[Path | None, typer.Option(help="Also write the newest RIG.toml there.")] = None,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """One rig: its drives, epochs, GNSS receivers and versions."""
    from wayloom.client.api import Api
    from wayloom.files.atomic import write_atomically
    from wayloom.pipeline.settings import load_settings

    url, rig = server_and_last(which, "RIG", server)
    chosen = [one for one in fetched(url, config) if one["id"].startswith(rig) or one["vehicle_id"] == rig]
    if len(chosen) != 1:
        raise NotFoundError(f"{len(chosen)} rigs are called {rig!r}; `wayloom rigs list {url}` shows them")
    say = words(as_json)
    for text in lines(chosen[0]):
        say(text)
    if out is not None:
        with Api(url, load_settings(config).settings.api_key) as api:
            write_atomically(out, api.once("GET", f"/v1/rigs/{chosen[0]['id']}/RIG.toml").content)
        say(f"written: {out}")
    if as_json:
        print_json(chosen[0])


def fetched(url: str, config: Path | None) -> list[dict[str, Any]]:
    """The rigs of a service as it tells them."""
    from wayloom.client.api import Api
    from wayloom.pipeline.settings import load_settings

    with Api(url, load_settings(config).settings.api_key) as api:
        found: list[dict[str, Any]] = api.json("GET", "/v1/rigs")["rigs"]
    return found


def line(rig: dict[str, Any]) -> str:
    """A rig in one line."""
    newest = f"version {rig['versions'][0]['version']}" if rig["versions"] else "no version yet"
    clock = f", {clock_text(rig['receivers'][-1])}" if rig["receivers"] else ""
    return f"{rig['id'][:12]}  {rig['vehicle_id'] or '-'} {rig['rig_id'] or '-'}: {len(rig['drives'])} drives, {newest}{clock}"


def lines(rig: dict[str, Any]) -> list[str]:
    """A rig in full."""
    out = [line(rig), "epochs of the cameras:"]
    out += [f"  from {when(one['from_time'])}: {one['drives']} drives{jump(one)}" for one in rig["epochs"]]
    out += ["epochs of the GNSS receiver:"] if rig["receivers"] else []
    out += [
        f"  from {when(one['from_time'])}: {len(one['drives'])} drives, {clock_text(one)}{jump(one)}" for one in rig["receivers"]
    ]
    out += ["versions:"] if rig["versions"] else []
    return out + [f"  {one['version']}: {one['reason']}, {len(one['drives'])} drives" for one in rig["versions"]]


def clock_text(receiver: dict[str, Any]) -> str:
    """What is known of the clock."""
    return f"GNSS clock {1e3 * receiver['time_offset_s']:+.1f} ms (sigma {1e3 * receiver['sigma_time_offset_s']:.1f} ms)"


def jump(epoch: dict[str, Any]) -> str:
    """Why an epoch began."""
    note = "" if epoch["chi_square"] is None else f", changed (chi-square {epoch['chi_square']:.0f})"
    return note + (", a stray" if epoch["stray"] else "")


def when(t_s: float) -> str:
    """UTC, to the minute."""
    return datetime.fromtimestamp(t_s, UTC).strftime("%Y-%m-%d %H:%M")
