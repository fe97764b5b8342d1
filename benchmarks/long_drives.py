"""Long drives: in parts against in one piece, memory against length, and time with one process and with two.

    python benchmarks/long_drives.py [--data FOLDER] [--long FOLDER] [--seeds 3] [--laps 1 4 16] [--stages 1 4] [--whole 4]
                                     [--json FILE] [--write]

--data    the recordings as docs/results.md describes them; clip A is tracked in one piece and in three parts
--long    a drive of `wayloom simulate long --size quarter --laps N`, of as many laps as the largest number asked for
--seeds   of the choice of points; 0: accuracy is not measured
--laps    lengths of which memory and time of the odometry are measured, each in a process of its own
--joins   numbers of made parts, as large as those of a drive like clip A, whose join is measured
--labelled  numbers of made parts, as those of --joins, whose points are labelled by made images
--placed  laps of --long that are geo-referenced, cut into submaps and exported: its truth with an odometry's noise, and points as
          clip A would give
--stages  lengths of which memory of every stage is measured, each in a process of its own
--whole   lengths of which memory of every stage is measured as one process runs them all on two threads, as a rule beside one
          another; without loops
--write   the tables into docs/benchmarks/long_drives.md; those that are not measured again stay as they are
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "core"))

import numpy as np  # noqa: E402

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.calibration.self_calibration import calibrate_drive  # noqa: E402
from wayloom.config.stages import drive_stages  # noqa: E402
from wayloom.evaluation.trajectory import evaluate  # noqa: E402
from wayloom.files.atomic import link_or_copy  # noqa: E402
from wayloom.geometry import se3  # noqa: E402
from wayloom.geometry.camera import PinholeCamera, StereoRig  # noqa: E402
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference  # noqa: E402
from wayloom.labelling.files import LABELS_FILE, save_labels  # noqa: E402
from wayloom.labelling.tcl import label_points  # noqa: E402
from wayloom.labelling.types import PointLabels  # noqa: E402
from wayloom.logs.registry import open_log  # noqa: E402
from wayloom.logs.types import DriveLog  # noqa: E402
from wayloom.loops.files import LOOPS_FILE, save_loops  # noqa: E402
from wayloom.loops.types import no_loops  # noqa: E402
from wayloom.odometry.odometry import track  # noqa: E402
from wayloom.odometry.parts.join import join_parts  # noqa: E402
from wayloom.odometry.parts.log_view import log_view  # noqa: E402
from wayloom.odometry.parts.plan import DrivePart, plan_parts  # noqa: E402
from wayloom.odometry.result.odometry_file import load_odometry, save_odometry  # noqa: E402
from wayloom.odometry.settings import OdometrySettings  # noqa: E402
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory  # noqa: E402
from wayloom.pipeline.exports import write_exports  # noqa: E402
from wayloom.pipeline.log_source import LogSource  # noqa: E402
from wayloom.pipeline.running import run_stage  # noqa: E402
from wayloom.pipeline.settings import ProcessSettings  # noqa: E402
from wayloom.pipeline.stage_context import StageContext  # noqa: E402
from wayloom.pipeline.stage_files import STAGE_FILE, digest_of_folder  # noqa: E402
from wayloom.pipeline.stages import georeference, odometry, submaps  # noqa: E402
from wayloom.submaps.files import StoredSubmaps  # noqa: E402

PAGE, LAP = DOCS / "benchmarks" / "long_drives.md", 484
CLIP_PARTS, LONG_PARTS = OdometrySettings(part_frames=94, part_overlap=40), OdometrySettings(part_frames=700, part_overlap=80)
WHOLE = 10**9


def main() -> None:
    """Measure, print, and write where asked."""
    options = parsed()
    if options.child:
        child(options.child)
        return
    if options.join:
        child_of_join(options.join)
        return
    if options.label:
        child_of_labelling(options.label)
        return
    if options.place:
        child_of_placing(Path(options.place[0]), options.place[1])
        return
    found: dict[str, Any] = {}
    if options.joins:
        found["joins"] = [
            json.loads(subprocess.run([sys.executable, __file__, "--join", str(count)], check=True, stdout=subprocess.PIPE).stdout)
            for count in options.joins
        ]
    if options.long and options.placed:
        found["geo-referencing"] = [placed(options.long, laps) for laps in options.placed]
    if options.labelled:
        found["labelling"] = [labelled(count) for count in options.labelled]
    if options.data:
        found["accuracy of clip A"] = accuracy(
            open_log(options.data / "kitti_odometry" / "sequences" / "00"), CLIP_PARTS, options.seeds
        )
    if options.long and options.seeds:
        found["accuracy of a simulated drive"] = accuracy(log_view(open_log(options.long), 0, 4 * LAP), LONG_PARTS, options.seeds)
    if options.long and options.laps:
        found["odometry"] = [measured_odometry(options.long, laps, *how) for laps in options.laps for how in ways_of(laps)]
    if options.long and options.stages:
        found["stages"] = [one for laps in options.stages for one in stages(options.long, laps)]
    if options.long and options.whole:
        found["whole"] = in_one_process([whole(options.long, laps) for laps in options.whole])
    print(json.dumps(found, indent=1))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    if options.write:
        for name, rows in found.items():
            put_between_marks(PAGE, name, table(rows))


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--long", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--laps", type=int, nargs="*", default=[1, 4, 16])
    parser.add_argument("--stages", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--whole", type=int, nargs="*", default=[4])
    parser.add_argument("--joins", type=int, nargs="*", default=[1, 3, 12])
    parser.add_argument("--labelled", type=int, nargs="*", default=[2, 12])
    parser.add_argument("--join", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--placed", type=int, nargs="*", default=[8])
    parser.add_argument("--label", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--place", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    return parser.parse_args()


def ways_of(laps: int) -> list[tuple[int, int]]:
    """Frames of a part and processes: in one piece; and, where that is more than one part, in parts by one and by two."""
    return [(WHOLE, 1)] if laps == 1 else [(WHOLE, 1), (LONG_PARTS.part_frames, 1), (LONG_PARTS.part_frames, 2)]


def accuracy(log: DriveLog, cut: OdometrySettings, seeds: int) -> list[dict[str, Any]]:
    """Errors against truth in one piece and in parts, for each seed of the choice of points, and how far the two are apart."""
    known, rows, ways = calibrate_drive(log), [], []
    for seed in range(seeds):
        settings = known.settings(cut.model_copy(update={"seed": seed}))
        whole = track(log, settings, lens=known.lens, matches=known.matches)
        results = {
            part.number: track(log_view(log, part.first, part.stop), settings, lens=known.lens, matches=known.matches)
            for part in plan_parts(len(log), settings)
        }
        joined = join_parts(plan_parts(len(log), settings), lambda part: results[part.number])  # noqa: B023
        ways.append(whole.trajectory.T_world_cam)
        apart = furthest(joined.trajectory.T_world_cam, ways[-1])
        rows += [row(log, whole, seed, "one piece", None), row(log, joined, seed, f"{len(results)} parts", apart)]
    between = [furthest(a, b) for a, b in combinations(ways, 2)] or [float("nan")]
    rows.append({"system": "one piece, two seeds", "furthest apart cm": f"{100 * min(between):.1f} to {100 * max(between):.1f}"})
    return rows


def row(log: DriveLog, result: OdometryResult, seed: int, system: str, apart_m: float | None) -> dict[str, Any]:
    """One result against truth. apart_m : the largest distance to the drive in one piece."""
    assert log.truth is not None
    errors, joints = evaluate(result.trajectory.T_world_cam, log.truth), result.report.get("joints", [])
    return {
        "system": system, "seed": seed, "ATE cm": round(100 * errors.ate_m, 1), "t_rel %": round(errors.t_rel_percent, 3),
        "r_rel °/100 m": round(errors.r_rel_deg_per_100m, 3), "length ratio": round(errors.length_ratio, 5),
        "furthest apart cm": None if apart_m is None else round(100 * apart_m, 1),
        "sigma of joints mm": None if not joints else ", ".join(f"{1000 * joint['sigma_m']:.0f}" for joint in joints),
        "their scales − 1 %": None if not joints else ", ".join(f"{100 * (joint['scale_ratio'] - 1):.2f}" for joint in joints),
        "keyframes": len(result.keyframes), "points": len(result.points), "observations": len(result.points.obs_keyframe),
    }  # fmt: skip


def furthest(a: np.ndarray, b: np.ndarray) -> float:
    """m: largest distance of two trajectories (n, 4, 4) that begin alike."""
    return float(np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1).max())


def first_frames(path: Path, folder: Path, frames: int) -> Path:
    """A drive in KITTI odometry layout as if it had ended after so many frames: its files, linked."""
    for file in path.rglob("*"):
        if (
            file.is_file()
            and file.relative_to(path).parts[0] != "truth"
            and not (file.suffix == ".png" and int(file.stem) >= frames)
        ):
            link_or_copy(file, folder / file.relative_to(path))
    return folder


def measured_odometry(path: Path, laps: int, part_frames: int, threads: int) -> dict[str, Any]:
    """The odometry alone of the first laps of a drive."""
    with tempfile.TemporaryDirectory(dir=path.parent) as temporary:
        log = first_frames(path, Path(temporary) / "log", laps * LAP)
        return in_a_process("odometry", log, Path(temporary), part_frames, threads)


def stages(path: Path, laps: int) -> list[dict[str, Any]]:
    """All stages of the first laps, one after the other."""
    with tempfile.TemporaryDirectory(dir=path.parent) as temporary:
        log = first_frames(path, Path(temporary) / "log", laps * LAP)
        return [in_a_process(stage, log, Path(temporary), LONG_PARTS.part_frames, 1) for stage in drive_stages()]


def whole(path: Path, laps: int) -> dict[str, Any]:
    """What `drive_cost.py` prints of the first laps."""
    with tempfile.TemporaryDirectory() as temporary:
        log = first_frames(path, Path(temporary) / "log", laps * LAP)
        drive = [str(log), str(Path(temporary) / "out"), "--cores", "2", "--no-loops", "--report"]
        command = [sys.executable, str(ROOT / "benchmarks/drive_cost.py"), *drive]
        return dict(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))


def in_one_process(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each stage, a column for each run."""
    stages = [*drive_stages(), "exports", "all"]
    return [
        {"stage": name} | {f"peak MB, {run['frames']} frames": round(run["stages"][name]["peak"] / 1e6) for run in runs}
        for name in stages
    ]


def in_a_process(stage: str, log: Path, folder: Path, part_frames: int, threads: int) -> dict[str, Any]:
    """A stage run in a process of its own. folder : with the stages before it, which it joins."""
    request = {"stage": stage, "log": str(log), "part_frames": part_frames, "threads": threads, "folder": str(folder)}
    command = [sys.executable, __file__, "--child", json.dumps(request)]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return found


def child(text: str) -> None:
    """Run one stage and say what it took."""
    request = json.loads(text)
    cut = OdometrySettings(part_frames=request["part_frames"], part_overlap=LONG_PARTS.part_overlap)
    settings, folder = ProcessSettings(threads=request["threads"], odometry=cut), Path(request["folder"])
    out = folder / request["stage"]
    out.mkdir()
    context = StageContext(LogSource(Path(request["log"])), folder, settings, parts_dir=folder / "parts")
    start = time.perf_counter()
    if request["stage"] == "odometry":
        odometry.run(context, out, lambda share, what: None)
        digest = {"stage": "odometry", "key": "", "seconds": 0.0, "digest": digest_of_folder(out)}
        (out / STAGE_FILE).write_text(json.dumps(digest))
    else:
        run_stage(request["stage"], context, out)
    seconds = time.perf_counter() - start
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    own, children = peak_mb(), used[1].ru_maxrss / 1024
    print(json.dumps({
        "stage": request["stage"], "frames": len(context.log),
        "how": "one piece" if request["part_frames"] == WHOLE else f"parts of {request['part_frames']}",
        "processes": request["threads"], "seconds": round(seconds, 1),
        "CPU s": round(sum(usage.ru_utime + usage.ru_stime for usage in used), 1), "peak MB": round(own),
        "peak MB of a child": round(children) if request["threads"] > 1 else None,
        "result MB": round(sum(file.stat().st_size for file in out.rglob("*") if file.is_file()) / 2**20, 1),
    }))  # fmt: skip


class MadeImages:
    """Label images of every voter alike, of as many classes as a network that is unsure gives a point."""

    may_be_void, is_balanced = False, False

    def __init__(self, shape: tuple[int, int] = (376, 1241)) -> None:
        self.labels = np.random.default_rng(0).integers(0, 11, shape).astype(np.uint8)

    def left(self, keyframe: int, /) -> np.ndarray:
        return self.labels

    def right(self, keyframe: int, /) -> np.ndarray:
        return self.labels

    def scores(self, side: str, keyframe: int, /) -> None:
        return None

    def sides(self, keyframe: int, /) -> tuple[str, ...]:
        return ("left",)

    def small(self, side: str, keyframe: int, /) -> np.ndarray:
        return np.zeros((188, 620), np.uint8)


def labelled(count: int) -> dict[str, Any]:
    """The points of so many made parts labelled, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        _, parts = made_plan(count)
        save_odometry(join_parts(parts, lambda part: made_part(OdometrySettings().part_frames)), Path(folder) / "whole.npz")
        command = [sys.executable, __file__, "--label", f"{folder}/whole.npz"]
        found: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        return found


def peak_mb() -> float:
    """The most memory that this process has held, without what its parent did before, which `ru_maxrss` counts."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024


def child_of_labelling(file: Path) -> None:
    """Label the points of a drive, and say what it took."""
    drive = load_odometry(file)
    before, start = peak_mb(), time.process_time()
    labels = label_points(drive, MadeImages())
    seconds, after = time.process_time() - start, peak_mb()
    print(json.dumps({
        "frames": len(drive.trajectory), "points": len(labels), "classes a point": round(len(labels.vote_class) / len(labels), 1),
        "CPU s": round(seconds, 1), "peak MB with the drive read": round(before), "peak MB": round(after),
    }))  # fmt: skip


def placed(path: Path, laps: int) -> dict[str, Any]:
    """The first laps of a drive geo-referenced without loops, cut into submaps and exported, each in a process of its own."""
    with tempfile.TemporaryDirectory(dir=path.parent) as temporary:
        folder = Path(temporary)
        log = open_log(first_frames(path, folder / "log", laps * LAP))
        drive = noisy_truth(log)
        rng, count = np.random.default_rng(1), len(drive.points)
        votes = 3 * np.arange(count + 1), np.tile(np.array([0, 2, 8], np.uint8), count), np.ones(3 * count, np.float32)
        labels = PointLabels(*rng.integers(0, 11, (3, count)).astype(np.uint8), *votes)
        (folder / "odometry").mkdir(), (folder / "labelling").mkdir(), (folder / "loops").mkdir()
        save_odometry(drive, folder / "odometry" / "odometry.npz")
        save_labels(labels, folder / "labelling" / LABELS_FILE)
        save_loops(no_loops(), folder / "loops" / LOOPS_FILE)
        found = {"frames": len(log), "keyframes": len(drive.keyframes), "points": count}
        del drive, labels, votes
        for stage in ("georeference", "submaps", "exports"):
            command = [sys.executable, __file__, "--place", temporary, stage]
            found |= json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        return found


def noisy_truth(log: DriveLog) -> OdometryResult:
    """The drive's truth with small errors of every step, and the points of `made_part`."""
    assert log.truth is not None
    rng, made, truth = np.random.default_rng(0), made_part(len(log)), np.asarray(log.truth)
    errors = rng.normal(size=(len(log) - 1, 6)) * [5e-4, 5e-4, 1e-3, 1e-5, 2e-5, 1e-5]
    T = [np.eye(4)]
    for before, after, error in zip(truth, truth[1:], errors, strict=False):
        T.append(T[-1] @ se3.inverse(before) @ after @ se3.exp(error))
    T_world_cam = np.array(T)
    trajectory = Trajectory(np.asarray(log.t_ns), T_world_cam, made.trajectory.tracked, made.trajectory.segment)
    keyframes = replace(made.keyframes, T_world_cam=T_world_cam[made.keyframes.frame])
    return replace(made, rig=log.rig, trajectory=trajectory, keyframes=keyframes)


def child_of_placing(folder: Path, stage: str) -> None:
    """Run a stage, or the exports of all points, and say what it took."""
    context, out = StageContext(LogSource(folder / "log"), folder, ProcessSettings()), folder / stage
    out.mkdir()
    start = time.process_time()
    if stage == "exports":
        drive = load_odometry(folder / "odometry" / "odometry.npz", "way")
        geo = load_georeference(folder / "georeference" / GEOREFERENCE_FILE)
        images: Any = MadeImages((drive.rig.camera.height, drive.rig.camera.width))
        write_exports(context.log, drive, images, geo, StoredSubmaps(folder / "submaps"), out)
    else:
        {"georeference": georeference, "submaps": submaps}[stage].run(context, out, lambda share, what: None)
    seconds, peak = time.process_time() - start, peak_mb()
    print(json.dumps({f"{stage}: CPU s": round(seconds), f"{stage}: peak MB": round(peak)}))


def made_plan(count: int) -> tuple[int, Sequence[DrivePart]]:
    """Frames of a drive of so many parts, and the parts."""
    settings = OdometrySettings()
    frames = settings.part_overlap + count * (settings.part_frames - settings.part_overlap)
    return frames, plan_parts(frames, settings)


def child_of_join(count: int) -> None:
    """Join so many made parts and write the result, and say what it took beyond what the modules and one part take."""
    settings = OdometrySettings()
    frames, parts = made_plan(count)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.npz"
        save_odometry(made_part(settings.part_frames), file)
        load_odometry(file)
        before = peak_mb()
        start = time.perf_counter()
        result = join_parts(parts, lambda part: load_odometry(file))
        save_odometry(result, Path(folder) / "whole.npz")
        seconds, size = time.perf_counter() - start, (Path(folder) / "whole.npz").stat().st_size / 2**20
    after = peak_mb()
    print(json.dumps({
        "parts": count, "frames": frames, "points": len(result.points), "result MB": round(size), "seconds": round(seconds, 1),
        "peak MB before": round(before), "peak MB": round(after),
    }))  # fmt: skip


def made_part(frames: int) -> OdometryResult:
    """A part along a straight way with a keyframe every second frame, 140 points a frame and 5 observations a point: as clip A."""
    T, n = np.tile(np.eye(4), (frames, 1, 1)), 140 * frames
    T[:, 2, 3] = 0.7 * np.arange(frames)
    keyframes, rng = np.arange(0, frames, 2), np.random.default_rng(0)
    host = np.sort(rng.integers(0, len(keyframes), n))
    observed = np.minimum(host[:, None] + np.arange(1, 6), len(keyframes) - 1).ravel()
    points = Points(
        host.astype(np.int32), rng.uniform(10, 300, (n, 2)).astype(np.float32), np.full(n, 0.1, np.float32),
        np.full(n, 1e-6, np.float32), np.zeros(n, np.uint8), 5 * np.arange(n + 1), observed.astype(np.int32), np.ones(5 * n, bool),
        np.ones(n, bool),
    )  # fmt: skip
    none, no_rows = np.zeros(frames, np.int32), np.zeros(3)
    report = {"activated_points": n, "losses": [], "doubted_steps": 0, "imu": None, "disparity_bias_px": 0.0}
    return OdometryResult(
        StereoRig(PinholeCamera(700.0, 700.0, 620.0, 187.0, 1241, 376), (-0.5, 0.0, 0.0)),
        Trajectory(np.arange(frames) * 10**8, T, np.ones(frames, bool), none),
        Keyframes(keyframes.astype(np.int32), T[keyframes], np.zeros((len(keyframes), 4)), none[keyframes]), points, 0.0, no_rows,
        report,
    )  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown, a dash for what is not there."""
    names = list(dict.fromkeys(name for one in rows for name in one))
    lines = [names, ["---"] * len(names), *([str("–" if one.get(name) is None else one[name]) for name in names] for one in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    main()
