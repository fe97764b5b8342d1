"""Rig memory on rendered drives, through the service: a worn rig's five drives one after another, then two after a knock.

    python benchmarks/rig_memory.py [--size full] [--gnss] [--no-knock] [--receiver] [--cache FOLDER] [--write]

Each drive is uploaded to a service with processes of its own when the one before is done; stages that have nothing to do with rigs
are passed over. The table gives, drive by drive, the version of the rig's file that it was tracked with, the error of the
odometry's scale against the truth and the sigma that was stated.

--gnss   with the drives' RTK; without, what images alone say: the logs are sent without their fixes
--no-knock  only the five drives before the knock
--receiver  instead, three drives with RTK of a vehicle whose GNSS clock is 20 ms late and stated nowhere: one with a turn, one
         straight on, one with a turn after the clock has become 80 ms late
--write  the table into docs/benchmarks/rig_memory.md

Drives are drawn where they do not yet lie in the cache folder: about a minute of processor time for each of full size.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pages import DOCS, put_between_marks
from wayloom.client.api import Api
from wayloom.client.manifests import pack
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.config.classes import VOID
from wayloom.evaluation.odometry_table import head, row
from wayloom.evaluation.trajectory import evaluate
from wayloom.labelling.files import LABELS_FILE, save_labels
from wayloom.labelling.types import PointLabels
from wayloom.logs.registry import open_log
from wayloom.loops.files import LOOPS_FILE, save_loops
from wayloom.loops.types import no_loops
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.pipeline.stage_files import STAGE_FILE, digest_of_folder
from wayloom.simulation.recording.presets import RIG, RIG_WAYS, DrivePlan, Preset
from wayloom.simulation.recording.simulate import OutputSettings, simulate
from wayloom.simulation.vehicle.rig_faults import WORN
from wayloom.simulation.vehicle.vehicle_settings import ClockSettings, RightLensSettings, VehicleSettings
from wayloom_workers.production import stage_hooks
from wayloom_workers.stage_hooks import StageAttempt, StageHooks, key_of_inputs, keyed_by_inputs

PAGE = DOCS / "benchmarks" / "rig_memory.md"
TURN = {"pitch_rad": 0.002, "yaw_rad": -0.003, "roll_rad": 0.0015}
KNOCKED = WORN.model_copy(update={name: getattr(WORN, name) + by for name, by in TURN.items()})
"""The worn rig after a knock that turned the right camera by 2 to 3 mrad: one to two pixels of full-size images."""
AFTER = (0, 3)
"""The ways, of RIG_WAYS, that are driven again after the knock."""
LATER_S = 600.0
CLOCKS = (("turn", 0, 0.02), ("straight", 4, 0.02), ("changed", 3, 0.08))
"""Name, way of RIG_WAYS and offset of the GNSS clock, s, of the drives of --receiver."""
PASSED_OVER = ("segmentation", "labelling", "places", "loops", "submaps")
SIZES = ("full", "half", "quarter")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one drive: what it was tracked with, by which share it is too long, and what was stated of that."""

    name: str
    used: dict[str, Any]
    longer: float
    scale: dict[str, Any]
    bias_px: float

    def cells(self) -> list[str]:
        """A row of the table."""
        version = "its own lens" if self.used["version"] is None else f"version {self.used['version']}"
        notes = f"knock noticed, chi² {self.used['chi_square']:.0f}" if self.used.get("knocked") else ""
        lens_sigma = self.scale["lens_sigma"]
        return [
            self.name, version, f"{100 * self.longer:+.3f}", f"{100 * lens_sigma:.3f}", f"{self.longer / lens_sigma:+.1f}",
            f"{100 * self.scale['sigma']:.3f}", notes,
        ]  # fmt: skip


def taxi(knocked: bool = False) -> Preset:
    """One worn rig on five ways; or, ten minutes later and after a knock, on two of them."""
    ways = (
        [(f"knocked-{n + 1}", k) for n, k in enumerate(AFTER)] if knocked else [(f"worn-{k + 1}", k) for k in range(len(RIG_WAYS))]
    )
    lens, later_s = (KNOCKED, LATER_S) if knocked else (WORN, 0.0)
    return RIG.model_copy(update={"drives": tuple(_plan(name, way, lens, later_s) for name, way in ways)})


def _plan(name: str, way: int, lens: RightLensSettings, later_s: float) -> DrivePlan:
    nodes, reference, before_m, start_s = RIG_WAYS[way]
    return DrivePlan(
        vehicle_id=name, nodes=nodes, reference=reference, before_m=before_m, frames=120, start_s=start_s + later_s,
        vehicle=VehicleSettings(right_lens=lens, rig_name="worn"),
    )  # fmt: skip


def drawn(cache: Path, size: str, with_knock: bool) -> list[Path]:
    """The drives' folders, in the order in which they are driven."""
    folders = []
    for part, knocked in (("worn", False), ("knocked", True))[: 1 + with_knock]:
        folders += simulate(taxi(knocked), cache / f"rig-memory-{size}-{part}", OutputSettings(size=size), progress=say)
    return folders


def say(share: float, what: str) -> None:
    """Progress, to stderr."""
    sys.stderr.write(f"rig memory: {100 * share:.0f} % {what}\n")


def hooks(stage: str) -> StageHooks:
    """The workers' own, but for stages that neither ask a rig nor tell anything of it: these are passed over."""
    return StageHooks(keyed_by_inputs(_leave_mark)) if stage in PASSED_OVER else stage_hooks(stage)


def _leave_mark(attempt: StageAttempt) -> None:
    """What later stages can read: points without labels, no loops, a stage.json."""
    stage, out_dir = attempt.claim.stage, attempt.out_dir
    (out_dir / "passed-over").touch()
    if stage == "labelling":
        count = len(load_odometry(attempt.inputs_dir / "odometry" / ODOMETRY_FILE).points)
        void, none = np.full(count, VOID, np.uint8), np.zeros(0)
        start = np.zeros(count + 1, np.int64)
        save_labels(PointLabels(void, void, void, start, none.astype(np.uint8), none.astype(np.float32)), out_dir / LABELS_FILE)
    if stage == "loops":
        save_loops(no_loops(), out_dir / LOOPS_FILE)
    about = {"stage": stage, "key": key_of_inputs(attempt), "digest": digest_of_folder(out_dir), "seconds": 0.0}
    (out_dir / STAGE_FILE).write_text(json.dumps(about))


@contextmanager
def service(data: Path) -> Iterator[Api]:
    """A service of one worker in processes of its own."""
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = {**os.environ, "PYTHONPATH": paths, "WAYLOOM_STAGE_HOOKS": "rig_memory:hooks"}
    ready = data.parent / f"{data.name}.ready"
    command = [sys.executable, "-m", "wayloom.cli.main", "up", "--data", str(data), "--port", "0", "--ready-file", str(ready)]
    process = subprocess.Popen(
        command, env=variables, stdout=subprocess.DEVNULL, stderr=(data.parent / f"{data.name}.log").open("w")
    )
    try:
        while not ready.is_file():
            if process.poll() is not None:
                raise RuntimeError("the service did not start")
            time.sleep(0.1)
        with Api(ready.read_text().strip()) as api:
            yield api
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def outcome(api: Api, data: Path, folder: Path, with_gnss: bool) -> Outcome:
    """Send a drive, wait until the service has done with it, and judge its odometry."""
    say(0.0, f"{folder.name}: sent")
    if not with_gnss:
        folder = Path(shutil.copytree(folder, data.parent / folder.name, ignore=shutil.ignore_patterns("gnss*")))
    drive = wait_for_drive(api, upload(api, pack(folder, vehicle_id="taxi"))["id"])
    if drive["state"] == "failed":
        raise RuntimeError(f"{folder.name}: {drive['error']}")
    results = (data / "drives" / drive["id"] / "stages" / "odometry").glob(f"*/{ODOMETRY_FILE}")
    odometry = load_odometry(max(results, key=lambda file: file.stat().st_mtime_ns))
    truth = open_log(folder).truth
    assert truth is not None
    longer = evaluate(odometry.trajectory.T_world_cam, truth).length_ratio - 1.0
    return Outcome(folder.name, drive["facts"]["rig"], longer, odometry.report["scale"], odometry.disparity_bias_px)


def receiver_drives(cache: Path, size: str) -> list[Path]:
    """The drives of --receiver, ten minutes apart."""
    plans = []
    for count, (name, way, late_s) in enumerate(CLOCKS):
        nodes, reference, before_m, start_s = RIG_WAYS[way]
        vehicle = VehicleSettings(rig_name="clock", clock=ClockSettings(offset_s=late_s))
        plans.append(DrivePlan(
            vehicle_id=name, nodes=nodes, reference=reference, before_m=before_m, frames=120, start_s=start_s + LATER_S * count,
            vehicle=vehicle,
        ))  # fmt: skip
    preset = RIG.model_copy(update={"drives": tuple(plans)})
    return simulate(preset, cache / f"rig-memory-{size}-clock", OutputSettings(size=size), progress=say)


def receiver_row(api: Api, folder: Path, late_s: float) -> list[str]:
    """Send a drive of --receiver and say how the service placed it."""
    say(0.0, f"{folder.name}: sent")
    drive = wait_for_drive(api, upload(api, pack(folder, vehicle_id="taxi"))["id"])
    if drive["state"] == "failed":
        raise RuntimeError(f"{folder.name}: {drive['error']}")
    geo = drive["facts"]["georeference"]
    sigma_m = float(np.linalg.norm(geo["sigma_enu_m"]["median"]))
    known = " and ".join(geo["receiver_known_by"]) or "nobody"
    denied = "denied" if any("denies the GNSS clock" in message for message in geo["messages"]) else ""
    return [
        folder.name, f"{1e3 * late_s:.0f}", known, f"{1e3 * geo['time_offset_s']:.1f}", f"{1e3 * geo['sigma_time_offset_s']:.1f}",
        f"{sigma_m:.3f}", geo["grade"], denied,
    ]  # fmt: skip


def receiver_table(options: argparse.Namespace) -> str:
    """As Markdown: the three drives of --receiver, one after another through a service."""
    folders = receiver_drives(options.cache, options.size)
    with tempfile.TemporaryDirectory() as temporary, service(Path(temporary) / "data") as api:
        rows = [receiver_row(api, folder, late_s) for folder, (_, _, late_s) in zip(folders, CLOCKS, strict=True)]
        (rig,) = api.json("GET", "/v1/rigs")["rigs"]
    say(1.0, f"{len(rig['receivers'])} epochs of the receiver, of {[len(epoch['drives']) for epoch in rig['receivers']]} drives")
    columns = ["drive", "clock late by ms", "known by", "found ms", "sigma ms", "sigma of the place m", "grade", ""]
    return "\n".join([*head(columns), *(row(cells) for cells in rows), ""])


def table(outcomes: list[Outcome]) -> str:
    """As Markdown."""
    columns = ["drive", "tracked with", "scale error %", "sigma by the lens %", "error / sigma", "sigma with the baseline %", ""]
    return "\n".join([*head(columns), *(row(one.cells()) for one in outcomes), ""])


def main() -> None:
    """Draw, send, measure, print, and where asked for write."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wayloom" / "benchmark-drives"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="full", choices=SIZES)
    parser.add_argument("--gnss", action="store_true")
    parser.add_argument("--no-knock", action="store_true")
    parser.add_argument("--receiver", action="store_true")
    parser.add_argument("--cache", type=Path, default=cache, help="of simulated drives")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.receiver:
        text = receiver_table(options)
        print(text)
        if options.write:
            put_between_marks(PAGE, f"rig memory {options.size} receiver", text)
        return
    folders = drawn(options.cache, options.size, not options.no_knock)
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary) / "data"
        with service(data) as api:
            text = table([outcome(api, data, folder, options.gnss) for folder in folders])
            (rig,) = api.json("GET", "/v1/rigs")["rigs"]
    say(1.0, f"{len(rig['versions'])} versions, epochs of {[epoch['drives'] for epoch in rig['epochs']]} drives")
    print(text)
    if options.write:
        put_between_marks(PAGE, f"rig memory {options.size}{' with gnss' if options.gnss else ''}", text)


if __name__ == "__main__":
    main()
