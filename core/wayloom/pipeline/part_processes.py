"""Processes that track parts of one drive at a time, as many as the run has threads."""

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Final

from wayloom.config.child_processes import ending_with_parent
from wayloom.config.progress import Progress
from wayloom.odometry import warm_up
from wayloom.odometry.backend.visual_inertial import for_log
from wayloom.odometry.parts.plan import DrivePart
from wayloom.pipeline.stage_context import StageContext

PROGRAM: Final = "wayloom.pipeline.part_process"
ASK_EVERY_S: Final = 0.2


class PartProcesses:
    """Runs one process a part. shares : of each part by its number, how much of it is done."""

    def __init__(self, context: StageContext, parts_dir: Path) -> None:
        source, settings = context.source, context.settings.model_copy(update={"threads": 1})
        self.request = {
            "log": str(source.path), "gnss": None if source.gnss_path is None else str(source.gnss_path),
            "inputs_dir": str(context.inputs_dir), "parts_dir": str(parts_dir), "settings": settings.model_dump(mode="json"),
        }  # fmt: skip
        self.shares: dict[int, float] = {}
        self.running: set[subprocess.Popen[str]] = set()
        self.lock, self.stopped = threading.Lock(), False

    def run(self, part: DrivePart) -> None:
        """Until the process of this part has ended, well or not."""
        with self.lock:
            if self.stopped:
                return
            process = subprocess.Popen(
                [sys.executable, "-m", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                text=True, preexec_fn=ending_with_parent(signal.SIGKILL), start_new_session=True,
            )  # fmt: skip
            self.running.add(process)
        assert process.stdin is not None
        assert process.stdout is not None
        with process:
            try:
                process.stdin.write(json.dumps(self.request | {"part": part.number}))
                process.stdin.close()
                for line in process.stdout:
                    self.shares[part.number] = float(line)
            except BrokenPipeError:
                return
            finally:
                process.wait()
                self.running.discard(process)

    def stop(self) -> None:
        """End all processes and begin none."""
        with self.lock:
            self.stopped = True
            for process in list(self.running):
                process.kill()


def track_in_processes(context: StageContext, parts: Sequence[DrivePart], parts_dir: Path, progress: Progress) -> None:
    """Track these parts into their places in `parts_dir`. Those whose process failed are not there afterwards."""
    warm_up.compile_odometry(for_log(context.log, context.settings.odometry) is not None, progress)
    processes, frames = PartProcesses(context, parts_dir), {part.number: len(part) for part in parts}
    with ThreadPoolExecutor(context.settings.threads) as pool:
        try:
            waiting = {pool.submit(processes.run, part) for part in parts}
            while waiting:
                _, waiting = wait(waiting, ASK_EVERY_S)
                done = sum(frames[number] * share for number, share in list(processes.shares.items()))
                progress(done / sum(frames.values()), f"tracking {len(parts)} parts, {context.settings.threads} at a time")
        finally:
            processes.stop()
