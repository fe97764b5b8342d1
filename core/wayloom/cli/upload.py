"""`wayloom upload`: drive logs to a service, resumed where an earlier try ended."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.options import ConfigOption
from wayloom.cli.progress_bars import ProgressBars
from wayloom.errors import ConfigError, NotFoundError

if TYPE_CHECKING:
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
    again: Annotated[bool, typer.Option("--again", help="Send also what the service had and deleted after processing.")] = False,
    config: ConfigOption = None,
) -> None:
    """Send drive logs to a service. Run it again after any interruption: it continues where the service has it."""
    from wayloom.client.api import Api
    from wayloom.client.manifests import pack
    from wayloom.files.atomic import write_atomically
    from wayloom.pipeline.settings import load_settings

    if gnss is not None and len(logs) > 1:
        raise ConfigError("--gnss belongs to one drive, several were given", remedy="send the drives one by one")
    key = load_settings(config).settings.api_key
    with Api(to, key, connections) as api, ProgressBars(sys.stdout) as bars:
        packed_drives = [pack(path, gnss, vehicle, bars(f"{path.name}, reading")) for path in logs]
        before = [finished_stages(api, packed_drive.manifest.drive_id) for packed_drive in packed_drives]
        sent = [send(api, packed_drive, bars, connections, again) for packed_drive in packed_drives]
        drives = [
            follow(api, drive_id, bars, done) if wait else api.drive(drive_id) for drive_id, done in zip(sent, before, strict=True)
        ]
    for drive in drives:
        print(summary(drive))
    if json_file is not None:
        write_atomically(json_file, (json.dumps({"drives": drives}, indent=1) + "\n").encode())
    if any(drive["state"] == "failed" for drive in drives):
        raise typer.Exit(1)


def send(api: "Api", packed_drive: "PackedDrive", bars: ProgressBars, connections: int, again: bool = False) -> str:
    """Upload one drive under a bar. Returns its id."""
    from wayloom.client.upload import upload

    return str(upload(api, packed_drive, bars(f"{packed_drive.manifest.name}, sending"), connections, again=again)["id"])


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
