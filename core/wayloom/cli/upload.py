"""`wayloom upload`: drive logs to a service, resumed where an earlier try ended."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.errors import ConfigError, NotFoundError

if TYPE_CHECKING:
    from rich.progress import Progress

    from wayloom.client.api import Api
    from wayloom.client.manifests import PackedDrive


def upload_command(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG…", help="Drive logs.")],
    to: Annotated[str, typer.Option(help="Address of the service, e.g. http://127.0.0.1:8088")],
    gnss: Annotated[Path | None, typer.Option(help="GNSS log kept beside the drive (one LOG only).")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Show the stages until the drives are in the map.")] = False,
    vehicle: Annotated[str | None, typer.Option(help="Id of the vehicle that drove.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what the service says of each drive there.")] = None,
    connections: Annotated[int, typer.Option(min=1, max=32, help="Files sent at once.")] = 4,
) -> None:
    """Send drive logs to a service. Run it again after any interruption: it continues where the service has it."""
    from wayloom.client.api import Api
    from wayloom.client.manifests import pack
    from wayloom.files.atomic import write_atomically

    if gnss is not None and len(logs) > 1:
        raise ConfigError("--gnss belongs to one drive, several were given", remedy="send the drives one by one")
    with Api(to, connections=connections) as api, progress_bars() as bars:
        packed_drives = []
        for path in logs:
            bar = bars.add_task(f"{path.name}: reading", total=None, words="")
            packed_drives.append(pack(path, gnss, vehicle, lambda done, of, bar=bar: bars.update(bar, completed=done, total=of)))  # type: ignore[misc]
            bars.remove_task(bar)
        before = [finished_stages(api, packed_drive.manifest.drive_id) for packed_drive in packed_drives]
        sent = [send(api, packed_drive, bars, connections) for packed_drive in packed_drives]
        drives = [
            follow(api, drive_id, bars, done) if wait else api.drive(drive_id) for drive_id, done in zip(sent, before, strict=True)
        ]
    for drive in drives:
        print(summary(drive))
    if json_file is not None:
        write_atomically(json_file, (json.dumps({"drives": drives}, indent=1) + "\n").encode())
    if any(drive["state"] == "failed" for drive in drives):
        raise typer.Exit(1)


def send(api: "Api", packed_drive: "PackedDrive", bars: "Progress", connections: int) -> str:
    """Upload one drive under a bar of bytes. Returns its id."""
    from wayloom.client.upload import upload

    bar = bars.add_task(f"{packed_drive.manifest.name}: sending", total=packed_drive.manifest.byte_count, words="")
    registration = upload(api, packed_drive, lambda done, of: bars.update(bar, completed=done, total=of), connections)
    bars.update(bar, description=f"{packed_drive.manifest.name}: sent", completed=packed_drive.manifest.byte_count)
    return str(registration["id"])


def finished_stages(api: "Api", drive_id: str) -> set[str]:
    """The stages that an earlier upload of the same drive has been through; none where the server does not know it."""
    try:
        return {stage["stage"] for stage in api.drive(drive_id)["stages"] if stage["state"] == "done"}
    except NotFoundError:
        return set()


def follow(api: "Api", drive_id: str, bars: "Progress", before: set[str]) -> dict[str, Any]:
    """Show each stage as a line of its own until the drive is in the map or has failed.

    before : the stages that were done when the command began
    """
    from wayloom.client.watch import wait_for_drive

    lines: dict[str, Any] = {}
    finished: set[str] = set()

    def on_progress(drive: dict[str, Any]) -> None:
        for stage in drive["stages"]:
            name = stage["stage"]
            if stage["state"] == "waiting" and name not in lines:
                continue
            if name not in lines:
                lines[name] = bars.add_task(f"{drive['name']}: {name}", total=1.0, words="")
            bars.update(lines[name], completed=stage["progress"], words=stage["message"] or stage["state"])
            if stage["state"] == "done" and name not in finished:
                finished.add(name)
                if not bars.console.is_terminal:
                    when = "before" if name in before else f"in {stage['seconds']:.1f} s"
                    print(f"{drive['name']}: {name} done {when}", flush=True)

    return wait_for_drive(api, drive_id, on_progress)


def progress_bars() -> "Progress":
    """Bars on stderr; nothing where stderr is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = ("[progress.description]{task.description}", BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    console = Console(file=sys.stderr)
    return Progress(*columns, TextColumn("{task.fields[words]}"), console=console, disable=not console.is_terminal)


def summary(drive: dict[str, Any]) -> str:
    """One line on a drive."""
    words = {"done": "in the map", "failed": f"failed: {drive['error']}"}.get(drive["state"], drive["state"])
    return f"{drive['name']} ({drive['id'][:12]}): {drive['note'] or words}"
