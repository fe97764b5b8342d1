"""`wayloom demo`: the main job from beginning to end on this machine. `make demo` calls it."""

import contextlib
import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wayloom.cli.options import ConfigOption
from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.supervisor import compiling_kernels
from wayloom.config.child_processes import ending_with_parent
from wayloom.errors import ConfigError, ServiceError, StageError

if TYPE_CHECKING:
    from wayloom.client.api import Api

PRESET, SIZE = "demo", "half"
PORT = 8088
START_TIMEOUT_S = 90.0


@dataclass(frozen=True, slots=True)
class Fleet:
    """What the demo uploads: the logs, the GNSS log kept beside them, and the origin of the map that they ask for."""

    logs: list[Path]
    gnss: Path | None
    map_origin: tuple[float, float, float] | None = None


def demo_command(
    log: Annotated[Path | None, typer.Option(help="A drive log of your own instead of two simulated drives.")] = None,
    gnss: Annotated[Path | None, typer.Option(help="A GNSS log kept beside it.")] = None,
    model: Annotated[str | None, typer.Option(help="Network for the labels: a name of `wayloom models`, or a file.")] = None,
    once: Annotated[bool, typer.Option("--once", help="End when the map is there.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for the drives, the service's data and map.png.")] = Path("demo-out"),
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port of the service. [default: 8088, or a free one]")] = None,
    config: ConfigOption = None,
) -> None:
    """Simulate two drives (or take a log), upload them to a service, map them, and show the map."""
    from wayloom.cli.upload import finished_stages, follow, send, summary
    from wayloom.client.api import Api
    from wayloom.client.manifests import pack
    from wayloom.config.sources import Option, child_environment
    from wayloom.logs.registry import open_log
    from wayloom.pipeline.settings import load_settings
    from wayloom.pipeline.usable import check_usable

    started = time.monotonic()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # both end the service too
    if gnss is not None and log is None:
        raise ConfigError("a GNSS log belongs to a drive log", record="--gnss", remedy="give --log too")
    chosen = Option("--model", "segmentation.model", model)
    loaded = load_settings(config, chosen)
    check_usable(loaded)
    if log is None:
        fleet = simulated(out)
    else:
        open_log(log, gnss=gnss)  # a bad log is told before anything is started
        out = out / folder_of(log, gnss, loaded.settings.segmentation.model)
        fleet = Fleet([log], gnss)
    settings = load_settings(config, chosen, Option("the simulated city", "map_origin", fleet.map_origin)).settings
    with service(out / "service", free_port(port), child_environment(settings)) as (url, child):
        say(f"the service runs at {url}")
        if log is not None and settings.segmentation.model is None:
            say("labels: the built-in network knows simulated streets only; give another by --model (`wayloom models` lists some)")
        api = Api(url, settings.api_key)
        with ProgressBars(sys.stdout, elsewhere=True) as bars:
            packed_drives = [pack(path, fleet.gnss) for path in fleet.logs]
            before = [finished_stages(api, packed_drive.manifest.drive_id) for packed_drive in packed_drives]
            ids = [send(api, packed_drive, bars, 4) for packed_drive in packed_drives]
            drives = [follow(api, drive_id, bars, done) for drive_id, done in zip(ids, before, strict=True)]
        for drive in drives:
            say(summary(drive))
        failed = [drive for drive in drives if drive["state"] == "failed"]
        if failed:
            raise StageError(f"{failed[0]['name']} was not mapped: {failed[0]['error']}")
        write_map(api, drives, out / "map.png")
        say(f"the map: {out / 'map.png'} ({time.monotonic() - started:.0f} s from the start)")
        if not once:
            say(f"the dashboard: {url}   (Ctrl-C ends it)")
            with contextlib.suppress(KeyboardInterrupt):
                child.wait()


def say(text: str) -> None:
    """One line on standard output, now."""
    print(text, flush=True)


def simulated(out: Path) -> Fleet:
    """Two drives of the simulated city; drawn once, found again by later demos of this version."""
    from wayloom import __version__
    from wayloom.simulation.recording.presets import CITY_ORIGIN, PRESETS
    from wayloom.simulation.recording.simulate import OutputSettings, simulate

    folder = out / "drives"
    made_by = f"wayloom {__version__} {SIZE} {PRESETS[PRESET].model_dump_json()}\n"
    stamp = folder / "made-by.txt"
    logs = [folder / plan.vehicle_id for plan in PRESETS[PRESET].drives]
    if not stamp.is_file() or stamp.read_text() != made_by:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        stamp.write_text(made_by)  # now: what a demo that is stopped has drawn is used by the next
    if all(log.is_dir() for log in logs):
        say(f"the simulated drives are in {folder}")
    else:
        say("simulating two drives of the same streets (the first run compiles its kernels)")
        with compiling_kernels(), ProgressBars() as bars:
            simulate(PRESET, folder, OutputSettings(SIZE), threads=min(4, os.cpu_count() or 1), progress=bars("simulating"))
    return Fleet(logs, None, (CITY_ORIGIN.lon_deg, CITY_ORIGIN.lat_deg, CITY_ORIGIN.height_m))


def folder_of(log: Path, gnss: Path | None, model: str | None) -> str:
    """A folder's name of its own for each log, GNSS log and network."""
    named = hashlib.sha256("\n".join((str(log.resolve()), str(gnss and gnss.resolve()), str(model))).encode())
    return f"log-{log.resolve().name}-{named.hexdigest()[:8]}"


def free_port(wanted: int | None) -> int:
    """The wanted port; without a wish the usual one, or 0 (any) where that is taken."""
    if wanted is not None:
        return wanted
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", PORT))
        except OSError:
            return 0
        return PORT


@contextlib.contextmanager
def service(data: Path, port: int, environment: dict[str, str]) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """`wayloom up` as a child that does not outlive this process; its URL and the child while it runs.

    Raises ServiceError, with what it said, when it does not start.
    """
    data.mkdir(parents=True, exist_ok=True)
    ready = data / "ready"
    ready.unlink(missing_ok=True)
    command = [sys.executable, "-m", "wayloom.cli.main", "up", "--data", str(data), "--port", str(port), "--ready-file", str(ready)]
    up_log = data / "up.log"
    with up_log.open("w") as log:
        child = subprocess.Popen(command, env=environment, stdout=log, stderr=log, preexec_fn=ending_with_parent(signal.SIGTERM))
    try:
        deadline = time.monotonic() + START_TIMEOUT_S
        while not ready.is_file():
            if child.poll() is not None or time.monotonic() > deadline:
                last = (up_log.read_text().strip().splitlines() or ["it said nothing"])[-1]
                raise ServiceError(f"the service did not start: {last}; {up_log} has all that it said")
            time.sleep(0.1)
        yield ready.read_text().strip(), child
    finally:
        child.send_signal(signal.SIGTERM)
        child.wait()


def write_map(api: "Api", drives: list[dict[str, Any]], path: Path) -> None:
    """The newest version of the map, from its tiles: labels over the photograph of the ground, with the drives' tracks."""
    import cv2
    import numpy as np

    from wayloom.files.atomic import write_atomically
    from wayloom.reports.map_picture import TileLayer, map_picture
    from wayloom.tiles.descriptions import SUFFIXES, edge_px

    placed = [drive for drive in drives if drive["state"] == "done"]
    if not placed:
        say(f"no drive is in the map; the first is {drives[0]['note']}")
        write_atomically(path, api.once("GET", f"/v1/drives/{drives[0]['id']}/preview.png").content)
        return
    version = api.json("GET", f"/v1/maps/{placed[0]['map_id']}")
    tiles = f"/v1/maps/{version['map_id']}/versions/{version['version']}/tiles"

    def layer(name: str) -> TileLayer:
        def tile(z: int, x: int, y: int) -> bytes | None:
            answer = api.once("GET", f"{tiles}/{name}/{z}/{x}/{y}{SUFFIXES[name]}")
            return answer.content if answer.status_code == 200 else None

        return TileLayer(tile, int(version["layers"][name]["max_zoom"]), edge_px(name))

    photo = layer("ortho") if "ortho" in version["layers"] else None
    tracks = []
    for drive in placed:
        way = api.json("GET", f"/v1/drives/{drive['id']}/track")["geometry"]["coordinates"]
        tracks.append((drive["name"], np.array(way, np.float64)))
    picture = map_picture(layer("semantic"), tuple(version["bounds"]), tracks, photo)
    write_atomically(path, cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
