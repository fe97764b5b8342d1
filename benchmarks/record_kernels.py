"""Writes the list of kernels that stages call, with the types of their arguments: what `wayloom.pipeline.kernels_ahead` compiles.

    python benchmarks/record_kernels.py [--drives demo-out/drives]

Runs `wayloom demo`, and `wayloom process` on a drive that comes back to where it was, each with an empty cache of kernels and an
empty list, and notes in each process what numba compiles because Python called it, and in which stage. Nothing here is grey:
kernels for grey images are added by hand. --drives: simulated by a demo before.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from wayloom.pipeline.kernels_ahead import LIST

ROOT = Path(__file__).resolve().parents[1]
OWN_LIST = "wayloom.odometry."
"""The odometry's kernels have a list of their own."""
LISTENER = """
import json, os, sys, threading
from numba.core import event
from wayloom.config.kernel_types import words_of

depth = threading.local()
STAGES = {"run_stage": "name", "stitch": None}

def stage():
    frame = sys._current_frames()[threading.main_thread().ident]
    while frame is not None:
        name = frame.f_code.co_name
        if name in STAGES and ("running.py" in frame.f_code.co_filename or "stitching.py" in frame.f_code.co_filename):
            return frame.f_locals[STAGES[name]] if STAGES[name] else name
        if name == "write_products" and "drive_products.py" in frame.f_code.co_filename:
            return "exports"
        frame = frame.f_back
    return "prepare_stitch" if "wayloom_workers" in " ".join(sys.orig_argv) else ""

class Listener(event.Listener):
    def on_start(self, compiled):
        depth.now = getattr(depth, "now", 0) + 1
        kernel = compiled.data["dispatcher"].py_func
        if depth.now == 1 and kernel.__module__.startswith("wayloom."):
            try:
                words = words_of(tuple(compiled.data["args"]))
            except ValueError:
                words = None
            row = [stage(), kernel.__module__, kernel.__qualname__, words]
            with open(os.environ["RECORDED_KERNELS"], "a") as file:
                file.write(json.dumps(row) + "\\n")

    def on_end(self, compiled):
        depth.now -= 1

event.register("numba:compile", Listener())
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=Path)
    options = parser.parse_args()
    before = LIST.read_text() if LIST.is_file() else "[]\n"
    try:
        LIST.write_text("[]\n")
        rows = recorded(options.drives)
    except BaseException:
        LIST.write_text(before)
        raise
    found = entries(rows)
    LIST.write_text("[\n" + ",\n".join(json.dumps(one) for one in found) + "\n]\n")
    print(f"{sum(len(one['kernels']) for one in found)} kernels of {len(found)} modules in {LIST}")


def recorded(drives: Path | None) -> list[list[str | None]]:
    """[stage, module, kernel, words for its types, if they have any] of what was compiled from Python, in this order."""
    with tempfile.TemporaryDirectory(prefix="wayloom-kernels-") as name:
        folder = Path(name)
        (folder / "sitecustomize.py").write_text(LISTENER)
        out = folder / "rows"
        out.touch()
        if drives is not None:
            shutil.copytree(drives, folder / "demo" / "drives")
        path = os.pathsep.join([name, *(str(ROOT / part) for part in ("core", "services", "workers"))])
        environment = os.environ | {"PYTHONPATH": path, "RECORDED_KERNELS": str(out)}
        demo, drive = folder / "demo", folder / "loop"
        for number, command in enumerate((
            f"demo --once --port 0 --out {demo}",
            f"simulate loop --size half --out {drive}",
            f"process {drive / 'car-1'} --out {folder / 'mapped'} --threads 1",
        )):  # fmt: skip
            parts = [sys.executable, "-m", "wayloom.cli.main", *command.split()]
            subprocess.run(parts, env=environment | {"NUMBA_CACHE_DIR": f"{name}/cache-{number}"}, check=True)
        return [json.loads(line) for line in out.read_text().splitlines()]


def entries(rows: list[list[str | None]]) -> list[dict[str, Any]]:
    """The list. Named tuples have no words: kernels that take them are left to their first call, as are the simulation's."""
    found: dict[str, dict[str, Any]] = {}
    for stage, module, kernel, words in rows:
        if not stage or not module or module.startswith(OWN_LIST) or words is None:
            print(f"not listed: {stage or 'no stage'} {module}.{kernel} {words}")
            continue
        one = found.setdefault(module, {"module": module, "stages": [], "kernels": []})
        stage = "stitch" if stage == "prepare_stitch" else stage
        if stage not in one["stages"]:
            one["stages"].append(stage)
        if [kernel, words] not in one["kernels"]:
            one["kernels"].append([kernel, words])
    return list(found.values())


if __name__ == "__main__":
    main()
