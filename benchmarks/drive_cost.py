"""Runs one drive through `process_drive` and prints what each stage took, as JSON; the process that `cost.py` measures.

python benchmarks/drive_cost.py LOG OUT [--gnss PATH] [--model NAME] [--cores 1] [--no-loops] [--report]

--no-loops  no place of the drive is looked for again: of laps on one road that is most of what they would cost
--report    report.html and report.json too, as `wayloom process` writes them, with the exports
"""

import argparse
import json
import os
import resource
import sys
import time
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from pathlib import Path


@dataclass(frozen=True)
class Counters:
    """What a process and its ended children have used so far: seconds, seconds, bytes, bytes."""

    wall_s: float
    cpu_s: float
    read: float
    written: float

    def minus(self, other: "Counters") -> "Counters":
        return Counters(*(getattr(self, field.name) - getattr(other, field.name) for field in fields(self)))


def counters() -> Counters:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    io = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    cpu = sum(one.ru_utime + one.ru_stime for one in used)
    return Counters(time.perf_counter(), cpu, float(io["rchar"]), float(io["wchar"]))


def peak_bytes() -> int:
    """The most memory that this process held since `forget_peak`, or a child ever."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    own = int(lines["VmHWM"].split()[0])
    return 1024 * max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


class Meter:
    """A `NamedProgress` that reads the counters where a stage says that it starts and that it is done."""

    def __init__(self) -> None:
        self.began: dict[str, Counters] = {}
        self.used: dict[str, Counters] = {}
        self.peaks: dict[str, int] = {}

    def __call__(self, name: str, /):  # type: ignore[no-untyped-def]
        def progress(share: float, what: str, /) -> None:
            if name not in self.began:
                forget_peak()
                self.began[name] = counters()
            if share == 1.0:
                self.used[name] = counters().minus(self.began[name])
                self.peaks[name] = peak_bytes()

        return progress


def folder_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else 0


def measured(log: Path, out: Path, gnss: Path | None, model: str | None, cores: int, report: bool) -> dict[str, object]:
    """Frames, keyframes, metres and, for each stage, its counters, peak and kept bytes; `all` is the whole process from here on."""
    start = counters()
    from wayloom.evaluation.trajectory import path_length
    from wayloom.pipeline.drive import process_drive
    from wayloom.pipeline.settings import ProcessSettings
    from wayloom.segmentation.settings import SegmentationSettings

    more = {}
    if report:
        from wayloom.reports.drive_report import write_report

        more["write_more"] = write_report
    meter = Meter()
    settings = ProcessSettings(threads=cores, segmentation=SegmentationSettings(model=model))
    result = process_drive(log, out, settings, gnss, meter, **more)
    whole = counters().minus(start)
    stages = {
        name: {**asdict(used), "peak": meter.peaks[name], "kept": folder_bytes(out / "stages" / name)}
        for name, used in meter.used.items()
    }
    stages["exports"]["kept"] = folder_bytes(out) - folder_bytes(out / "stages")
    kept = sum(int(stage["kept"]) for stage in stages.values())
    stages["all"] = {**asdict(whole), "peak": max(meter.peaks.values()), "kept": kept}
    return {
        "frames": len(result.log),
        "keyframes": len(result.odometry.keyframes),
        "metres": float(path_length(result.odometry.trajectory.T_world_cam[:, :3, 3])),
        "stages": stages,
    }


def leave_out_loops() -> None:
    """From now on the loop stage finds none."""
    from wayloom.loops.files import LOOPS_FILE, save_loops
    from wayloom.loops.types import no_loops
    from wayloom.pipeline.stages import loops

    loops.run = lambda context, out_dir, progress: save_loops(no_loops(), out_dir / LOOPS_FILE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--gnss", type=Path)
    parser.add_argument("--model")
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--no-loops", action="store_true")
    parser.add_argument("--report", action="store_true")
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: args.cores])
    import_module("wayloom.cli")  # threads of the algebra and heaps, as the command has them
    if args.no_loops:
        leave_out_loops()
    json.dump(measured(args.log, args.out, args.gnss, args.model, args.cores, args.report), sys.stdout)


if __name__ == "__main__":
    main()
