"""`wayloom upload`: drive logs to a service, resumed where an earlier try ended."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.options import ConfigOption, ToOption
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json, words
from wayloom.errors import ConfigError, NotFoundError

if TYPE_CHECKING:
    from wayloom.client.api import Api
    from wayloom.client.manifests import PackedDrive
    from wayloom.client.rates import RateLimit
    from wayloom.client.spool import Then


def upload_command(
    to: ToOption,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="LOG…", help="Drive logs.")] = None,
    gnss: Annotated[Path | None, typer.Option(help="GNSS log kept beside the drive (one LOG only).")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Show the stages until the drives are in the map.")] = False,
    vehicle: Annotated[str | None, typer.Option(help="Id of the vehicle that drove.")] = None,
    connections: Annotated[int, typer.Option(min=1, max=32, help="Files sent at once.")] = 4,
    again: Annotated[bool, typer.Option("--again", help="Send also what the service had and deleted after processing.")] = False,
    limit_rate: Annotated[str | None, typer.Option(metavar="RATE", help="Send no faster, e.g. 2MB/s.")] = None,
    spool: Annotated[
        Path | None, typer.Option("--watch", metavar="SPOOL", help="Upload each log of this folder when complete.")
    ] = None,
    then: Annotated[
        str, typer.Option(metavar="keep|delete|move", help="What becomes of a log of SPOOL that was accepted.")
    ] = "keep",
    move_to: Annotated[Path | None, typer.Option(metavar="DIR", help="Where --then move puts it.")] = None,
    settle: Annotated[
        float, typer.Option(min=0.0, metavar="SECONDS", help="A log that has not changed for so long is complete.")
    ] = 60.0,
    once: Annotated[bool, typer.Option("--once", help="With --watch: end when nothing is left to be sent.")] = False,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Send drive logs to a service. Run it again after any interruption: it continues where the service has it."""
    from wayloom.client.api import Api
    from wayloom.client.manifests import pack
    from wayloom.client.rates import UNLIMITED, RateLimit, bytes_a_second
    from wayloom.pipeline.settings import load_settings

    logs = logs or []
    if (spool is None) == (not logs):
        raise ConfigError("either logs or --watch SPOOL is to be given", remedy="give one of them")
    if as_json and spool is not None:
        raise ConfigError("--json tells of LOGs that are sent, --watch goes on for ever", remedy="leave one of the two out")
    if gnss is not None and len(logs) != 1:
        raise ConfigError("--gnss belongs to one drive, several were given", remedy="send the drives one by one")
    limit = UNLIMITED if limit_rate is None else RateLimit(bytes_a_second(limit_rate))
    key = load_settings(config).settings.api_key
    if spool is not None:
        with Api(to, key, connections) as api, ProgressBars() as bars:
            from wayloom.client.spool import Spool
            from wayloom.client.spooling import Watching, watch

            what, target = _then(then, move_to)
            watching = Watching(what, target, vehicle, connections, limit, progress=bars, say=lambda line: print(line, flush=True))
            watch(api, Spool(spool, settle), watching, once)
        return
    with Api(to, key, connections) as api, ProgressBars(elsewhere=True) as bars:
        packed_drives = [pack(path, gnss, vehicle, bars(f"{path.name}, reading")) for path in logs]
        before = [finished_stages(api, packed_drive.manifest.drive_id) for packed_drive in packed_drives]
        sent = [send(api, packed_drive, bars, connections, limit, again) for packed_drive in packed_drives]
        drives = [
            follow(api, drive_id, bars, done) if wait else api.drive(drive_id) for drive_id, done in zip(sent, before, strict=True)
        ]
    say = words(as_json)
    for drive in drives:
        say(summary(drive))
    if as_json:
        print_json({"drives": drives})
    if any(drive["state"] == "failed" for drive in drives):
        raise typer.Exit(1)


def _then(text: str, target: Path | None) -> "tuple[Then, Path | None]":
    from wayloom.client.spool import Then

    if text not in list(Then):
        raise ConfigError(f"--then {text} is unknown", remedy=f"use one of {', '.join(Then)}")
    if (text == Then.MOVE) != (target is not None):
        raise ConfigError("--then move and --move-to DIR belong together", remedy="give both or none")
    return Then(text), target


def send(
    api: "Api",
    packed_drive: "PackedDrive",
    bars: ProgressBars,
    connections: int,
    limit: "RateLimit | None" = None,
    again: bool = False,
) -> str:
    """Upload one drive under a bar. Returns its id."""
    from wayloom.client.rates import UNLIMITED
    from wayloom.client.upload import upload

    bar = bars(f"{packed_drive.manifest.name}, sending")
    return str(upload(api, packed_drive, bar, connections, limit=limit or UNLIMITED, again=again)["id"])


def finished_stages(api: "Api", drive_id: str) -> set[str]:
    """The stages that an earlier upload of the same drive has been through; none where the server does not know it."""
    try:
        return {stage["stage"] for stage in api.drive(drive_id)["stages"] if stage["state"] == "done"}
    except NotFoundError:
        return set()


def follow(api: "Api", drive_id: str, bars: ProgressBars, before: set[str]) -> dict[str, Any]:
    """Show the progress of each stage until the drive is in the map or has failed.

    before : the stages that were done when the command began
    """
    from wayloom.client.watch import wait_for_drive

    name = api.drive(drive_id)["name"]
    return wait_for_drive(api, drive_id, lambda stage: bars(f"{name}, {stage}"), before)


def summary(drive: dict[str, Any]) -> str:
    """One line on a drive."""
    grade = (drive.get("quality") or {}).get("grade")
    merged = f"in the map, grade {grade}" if grade else "in the map"
    words = {"done": merged, "failed": f"failed: {drive['error']}"}.get(drive["state"], drive["state"])
    return f"{drive['name']} ({drive['id'][:12]}): {drive['note'] or words}"
