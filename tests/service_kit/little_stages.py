"""Real but small stages for the tests of the service: they take a moment, leave files, and write down that they ran.

The drive says what shall happen: its `log/play.json` names for each stage its `seconds`, `fail` (how many attempts), `full` (how
often the disk is), `crash`, `hang`, `hoard` (bytes), or `bad`; for the drive its `grade` (A), or `placed` false. A stage, the
map's too, stays in its middle as long as there is a file `<stage>-waits` in the data folder (`held_up`).
"""

import errno
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from wayloom.config.gate import gate_of
from wayloom.config.stages import REMOVAL
from wayloom.errors import LogError
from wayloom.pipeline.digests import sha256_of_json
from wayloom.store import coming, drives, gate, map_versions, maps, reprocessing
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.tables.drives import SubmapRow
from wayloom.tiles.png import png_bytes
from wayloom_workers import production
from wayloom_workers.publishing import TILES_FILE, publish, request_publish, tidy
from wayloom_workers.removal import nothing, remove_files, remove_rows
from wayloom_workers.stage_hooks import PreparedStage, StageAttempt, StageHooks, at_once, key_of_inputs, keyed_by_inputs

LON, LAT = 8.4, 49.01
RUNS = "runs.txt"
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="80" height="40"><rect width="80" height="40" style="fill: #1264a3"/></svg>'
QUALITY = json.dumps(
    {"fixes": None, "bursts": [], "receiver": None, "scale": None, "drift": None, "loops": None, "pictures": {"track": SVG}}
).encode()


def note(attempt: StageAttempt, what: str) -> None:
    """One line for each thing that happens, in a file that all processes append to."""
    held = attempt.claim
    with (attempt.context.folders.root / RUNS).open("a") as file:
        file.write(f"{what} {held.stage} {held.attempt} {os.getpid()} {held.drive_id or held.map_id}\n")


def run(attempt: StageAttempt) -> None:
    """Take the time that the drive asks for, with progress, and leave a file that depends on the inputs."""
    note(attempt, "start")
    play = json.loads((Path(str(attempt.log_path)) / "play.json").read_text()).get(attempt.claim.stage, {})
    if play.get("bad"):
        raise LogError("is damaged", file=Path(str(attempt.log_path)) / "left.png", record="line 1", remedy="record it again")
    if play.get("hang"):
        time.sleep(1000)
    if play.get("hoard"):
        bytearray(play["hoard"])
    if play.get("crash"):
        os.abort()
    if begun(attempt) <= play.get("full", 0):
        raise OSError(errno.ENOSPC, "No space left on device")
    while waits_at(attempt.context.folders.root, attempt.claim.stage).exists():
        attempt.progress(0.5, "waits")  # and hears that it is to stop, or that the job is another's
        time.sleep(0.02)
    steps = max(1, round(play.get("seconds", 0.0) / 0.05))
    for step in range(steps):
        attempt.progress(step / steps, f"step {step + 1} of {steps}")
        time.sleep(0.05 if "seconds" in play else 0.0)
    if attempt.claim.attempt <= play.get("fail", 0):
        raise RuntimeError("no luck this time")
    earlier = sorted(folder.name for folder in attempt.inputs_dir.iterdir())
    (attempt.out_dir / "result.json").write_text(json.dumps({"stage": attempt.claim.stage, "after": earlier}))
    note(attempt, "end")


def waits_at(data: Path, stage: str) -> Path:
    """The file whose presence keeps the stage in its middle."""
    return data / f"{stage}-waits"


@contextmanager
def held_up(data: Path, stage: str) -> Iterator[None]:
    """Each run of the stage lasts until the end of this, however slow the machine is."""
    file = waits_at(data, stage)
    file.touch()
    try:
        yield
    finally:
        file.unlink()


def begun(attempt: StageAttempt) -> int:
    """How often the drive's stage was begun."""
    lines = (attempt.context.folders.root / RUNS).read_text().splitlines()
    return sum(line.split()[:2] == ["start", attempt.claim.stage] and line.endswith(str(attempt.claim.drive_id)) for line in lines)


def judge(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """The grade that the drive asks for, and a quality report with one picture."""
    drive = drives.get(session, str(attempt.claim.drive_id))
    play = json.loads((Path(str(attempt.log_path)) / "play.json").read_text())
    placed = play.get("placed", True)
    coming.note_place(drive, placed, [[LON, LAT, 100.0], [LON + 0.001, LAT + 0.0005, 100.0]] if placed else None)
    grade = play.get("grade", "A") if placed else None
    reasons = ["sigma of the position 2.00 m in the median"] if placed else ["no GNSS"]
    reprocessing.judge(session, drive.id, grade, reasons, gate_of(grade, attempt.context.settings.gate))
    coming.note(drive, quality=attempt.context.blobs.put(QUALITY))
    return []


def place(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """One submap of 100 m beside the others."""
    drive = drives.get(session, str(attempt.claim.drive_id))
    play = json.loads((Path(str(attempt.log_path)) / "play.json").read_text())
    if play.get("placed") is False:
        return []
    place_row(session, drive.id, drive.map_id)
    return []


def place_row(session: Session, drive_id: str, map_id: str) -> None:
    """The submap's row."""
    row = SubmapRow(
        drive_id=drive_id, map_id=map_id, position=0, digest=drive_id, point_count=5, frame=[8.5, 49.5, 0.0],
        T_enu_submap=np.eye(4).tolist(), covariance=np.eye(6).tolist(),
        min_lon=LON, min_lat=LAT, max_lon=LON + 0.001, max_lat=LAT + 0.001,
    )  # fmt: skip
    reprocessing.place_submaps(session, drive_id, [row])


def stitch(attempt: StageAttempt) -> None:
    """One coloured tile at every zoom, its colour the number of drives, and the same as an overlay."""
    note(attempt, "start")
    with attempt.context.database.read() as session:
        rows = maps.submaps(session, str(attempt.claim.map_id))
        base = maps.get(session, str(attempt.claim.map_id)).version
        before = map_versions.all_current_tiles(session, str(attempt.claim.map_id))
        boxes = map_versions.changed_boxes(session, str(attempt.claim.map_id))
    while waits_at(attempt.context.folders.root, "stitch").exists():
        time.sleep(0.02)
    rgba = np.zeros((256, 256, 4), np.uint8)
    rgba[64:192, 32:224] = (128, 64 + 10 * len(rows), 128, 255)
    content = png_bytes(rgba)
    digest = attempt.context.blobs.put(content)
    tiles = [tile(zoom, digest, len(content)) for zoom in range(12, 19)] if rows else []
    tiles += [{**entry, "layer": "parked"} for entry in tiles if int(str(entry["z"])) >= 16]
    said = {
        "base": base,
        "built_with": "",
        "taken_in": sorted(boxes),
        "regions": [],
        "moved": [],
        "facts": {},
        "dropped_regions": [],
        "dropped_tiles": [] if rows else sorted(before),
        "frame": [8.5, 49.5, 0.0],
        "drives": sorted({row.drive_id for row in rows}),
        "out_of_reach": [],
        "submaps": len(rows),
        "bounds": [LON, LAT, LON + 0.001, LAT + 0.001] if rows else None,
        "tiles": tiles,
    }
    (attempt.out_dir / TILES_FILE).write_text(json.dumps(said))
    note(attempt, "end")


def tile(zoom: int, digest: str, size: int) -> dict[str, object]:
    """The entry of the tile that holds the place."""
    x = int((LON + 180.0) / 360.0 * (1 << zoom))
    y = int((0.5 - np.arcsinh(np.tan(np.radians(LAT))) / (2 * np.pi)) * (1 << zoom))
    return {"layer": "semantic", "z": zoom, "x": x, "y": y, "digest": digest, "media_type": "image/png", "size": size}


def prepare(attempt: StageAttempt) -> PreparedStage:
    """`run`, made again where other settings are asked for."""
    with attempt.context.database.read() as session:
        asked = (drives.get(session, str(attempt.claim.drive_id)).coming or {}).get("asked")
    return PreparedStage(sha256_of_json([key_of_inputs(attempt), asked or {}]), lambda: run(attempt))


_HOOKS = {
    "georeference": StageHooks(prepare, record=at_once(judge)),
    "submaps": StageHooks(prepare, record=at_once(place)),
    "stitch": StageHooks(keyed_by_inputs(stitch), record=at_once(request_publish)),
    "publish": StageHooks(keyed_by_inputs(tidy), record=at_once(publish)),
    REMOVAL.name: StageHooks(keyed_by_inputs(nothing), share=remove_files, record=at_once(remove_rows)),
}


def hooks(stage: str) -> StageHooks:
    """What the workers do for a stage: for a drive's, `run`."""
    return _HOOKS.get(stage) or StageHooks(prepare)


def easy(attempt: StageAttempt) -> None:
    """A stage for a real log: it takes no time."""
    attempt.progress(0.5, "half")
    (attempt.out_dir / "result.json").write_text("{}")


def place_easily(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """As `place`, whatever the log is."""
    drive = drives.get(session, str(attempt.claim.drive_id))
    drive.placed = True
    gate.judge(session, drive.id, "A", [], "merge")
    place_row(session, drive.id, drive.map_id)
    return []


def easy_hooks(stage: str) -> StageHooks:
    """As `hooks`, for real logs."""
    if stage == "georeference":
        return StageHooks(keyed_by_inputs(easy))
    if stage == "submaps":
        return StageHooks(keyed_by_inputs(easy), record=at_once(place_easily))
    return _HOOKS.get(stage) or StageHooks(keyed_by_inputs(easy))


def odometry_hooks(stage: str) -> StageHooks:
    """As `easy_hooks`, but ingest and odometry are those of the service, and each part and whole of them is noted."""
    if stage not in ("ingest", "odometry"):
        return easy_hooks(stage)
    real = production.stage_hooks(stage)

    def prepare(attempt: StageAttempt) -> PreparedStage:
        prepared = real.prepare(attempt)
        parts = prepared.parts and replace(prepared.parts, make=noted(attempt, prepared.parts.make))
        return replace(prepared, run=noted(attempt, prepared.run), parts=parts)

    return replace(real, prepare=prepare)


def noted(attempt: StageAttempt, work: Callable[..., None]) -> Callable[..., None]:
    """The work, with a line at its start and one at its end: the second word is the stage, or stage/part."""
    name = f"{attempt.claim.stage}/{attempt.claim.part}" if attempt.claim.part else attempt.claim.stage

    def run(*arguments: object) -> None:
        for what in ("start", "end"):
            with (attempt.context.folders.root / RUNS).open("a") as file:
                file.write(f"{what} {name} {attempt.claim.attempt} {os.getpid()} {attempt.claim.drive_id}\n")
            if what == "start":
                work(*arguments)

    return run
