"""A table of real but small stages for the tests of the service: they take a moment, leave files, and write down that they ran.

The drive says what shall happen: its `log/play.json` names for each stage its `seconds`, `fail` (how many attempts), or `bad`.
"""

import json
import os
import time
from pathlib import Path

import numpy as np

from wayloom.errors import LogError
from wayloom.store import drives, jobs, maps
from wayloom.store.database import Session, now_s
from wayloom.store.jobs import JobMessage
from wayloom.store.queues import DRIVE_STAGES, REMOVE
from wayloom.store.tables import SubmapRow
from wayloom.tiles.png import png_bytes
from wayloom_workers.publishing import TILES_FILE, publish, request_publish, tidy
from wayloom_workers.removal import nothing, remove_files, remove_rows
from wayloom_workers.steps import StageAttempt, Step, Steps

LON, LAT = 8.4, 49.01
RUNS = "runs.txt"


def note(work: StageAttempt, what: str) -> None:
    """One line for each thing that happens, in a file that all processes append to."""
    with (work.bench.folders.root / RUNS).open("a") as file:
        file.write(f"{what} {work.claim.stage} {work.claim.attempt} {os.getpid()} {work.claim.drive_id or work.claim.map_id}\n")


def run(work: StageAttempt) -> None:
    """Take the time that the drive asks for, with progress, and leave a file that depends on the inputs."""
    note(work, "start")
    play = json.loads((Path(str(work.log_path)) / "play.json").read_text()).get(work.claim.stage, {})
    if play.get("bad"):
        raise LogError(
            "is damaged", file=work.bench.folders.root / "drives" / "left.png", record="line 1", remedy="record it again"
        )
    steps = max(1, round(play.get("seconds", 0.0) / 0.05))
    for step in range(steps):
        work.progress(step / steps, f"step {step + 1} of {steps}")
        time.sleep(0.05 if "seconds" in play else 0.0)
    if work.claim.attempt <= play.get("fail", 0):
        raise RuntimeError("no luck this time")
    earlier = sorted(folder.name for folder in work.inputs_dir.iterdir())
    (work.out_dir / "result.json").write_text(json.dumps({"stage": work.claim.stage, "after": earlier}))
    note(work, "end")


def place(session: Session, work: StageAttempt) -> list[JobMessage]:
    """One submap of 100 m beside the others."""
    drive = drives.get(session, str(work.claim.drive_id))
    play = json.loads((Path(str(work.log_path)) / "play.json").read_text())
    if play.get("placed") is False:
        drive.placed, drive.state, drive.finished_at = False, "done", now_s(session)
        return []
    drive.placed, drive.track = True, [[LON, LAT, 100.0], [LON + 0.001, LAT + 0.0005, 100.0]]
    place_row(session, drive.id, drive.map_id)
    job = jobs.request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id = "stitching", job.id
    return [JobMessage(job.id, job.queue)]


def place_row(session: Session, drive_id: str, map_id: str) -> None:
    """The submap's row."""
    row = SubmapRow(
        drive_id=drive_id, map_id=map_id, position=0, digest=drive_id, point_count=5, frame=[8.5, 49.5, 0.0],
        T_enu_submap=np.eye(4).tolist(), covariance=np.eye(6).tolist(),
        min_lon=LON, min_lat=LAT, max_lon=LON + 0.001, max_lat=LAT + 0.001,
    )  # fmt: skip
    maps.place_submaps(session, drive_id, [row])


def stitch(work: StageAttempt) -> None:
    """One coloured tile at every zoom, its colour the number of drives."""
    note(work, "start")
    with work.bench.database.read() as session:
        rows = maps.submaps(session, str(work.claim.map_id))
    rgba = np.zeros((256, 256, 4), np.uint8)
    rgba[64:192, 32:224] = (128, 64 + 10 * len(rows), 128, 255)
    content = png_bytes(rgba)
    digest = work.bench.blobs.put(content)
    said = {
        "frame": [8.5, 49.5, 0.0],
        "drives": sorted({row.drive_id for row in rows}),
        "out_of_reach": [],
        "submaps": len(rows),
        "bounds": [LON, LAT, LON + 0.001, LAT + 0.001] if rows else None,
        "tiles": [tile(zoom, digest, len(content)) for zoom in range(12, 19)] if rows else [],
    }
    (work.out_dir / TILES_FILE).write_text(json.dumps(said))
    note(work, "end")


def tile(zoom: int, digest: str, size: int) -> dict[str, object]:
    """The entry of the tile that holds the place."""
    x = int((LON + 180.0) / 360.0 * (1 << zoom))
    y = int((0.5 - np.arcsinh(np.tan(np.radians(LAT))) / (2 * np.pi)) * (1 << zoom))
    return {"layer": "semantic", "z": zoom, "x": x, "y": y, "digest": digest, "media_type": "image/png", "size": size}


STEPS: Steps = {
    **{stage: Step(run) for stage in DRIVE_STAGES[:-1]},
    "submaps": Step(run, record=place),
    "stitch": Step(stitch, record=request_publish),
    "publish": Step(tidy, record=publish),
    REMOVE: Step(nothing, share=remove_files, record=remove_rows),
}


def easy(work: StageAttempt) -> None:
    """A stage for a real log: it takes no time."""
    work.progress(0.5, "half")
    (work.out_dir / "result.json").write_text("{}")


def place_easily(session: Session, work: StageAttempt) -> list[JobMessage]:
    """As `place`, whatever the log is."""
    drive = drives.get(session, str(work.claim.drive_id))
    drive.placed = True
    job = jobs.request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id = "stitching", job.id
    place_row(session, drive.id, drive.map_id)
    return [JobMessage(job.id, job.queue)]


EASY_STEPS: Steps = {**STEPS, **dict.fromkeys(DRIVE_STAGES[:-1], Step(easy)), "submaps": Step(easy, record=place_easily)}
