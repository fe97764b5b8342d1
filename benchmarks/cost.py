"""What a drive costs: every stage of `process_drive` in CPU seconds, wall seconds on one and two cores, memory and bytes.

python benchmarks/cost.py [--drives A B city] [--networks wayloom-city efficientvit-b0] [--cores 1 2] [--against REVISION]
                          [--rounds 1] [--write] [--json FILE]
python benchmarks/cost.py --shares 8

Each run is a process of its own (`drive_cost.py`) with its cores pinned; a first run, which is not counted, compiles the kernels.
CPU is that of the process and of those that it starts; of several rounds the least counts. Peak memory is each stage's own.
`--against` runs a committed revision in turn with this tree, for ratios of CPU in one run. `city` is simulated first, at full size.
`--shares` writes cost.json, by which a test tells that a stage's share of CPU has grown: of so many pairs of runs over the first
frames of clip A the median share of the better run, and as noise the largest less the smallest.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pages import DOCS, put_between_marks

ROOT = Path(__file__).resolve().parents[1]
PAGE = DOCS / "benchmarks" / "cost.md"
SHARES = ROOT / "benchmarks" / "cost.json"
SHARE_FRAMES = 40
WEIGHTS = "efficientvit-b0-cityscapes/efficientvit_seg_b0_cityscapes.pt"
Measured = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One drive with one network."""

    drive: str
    network: str
    log: Path
    gnss: Path | None


@dataclass(frozen=True)
class Tree:
    """A version of the code: its folder, and where its converted networks and results go."""

    name: str
    folder: Path
    scratch: Path

    def call(self, *words: str | Path) -> str:
        paths = os.pathsep.join(str(self.folder / room) for room in ("core", "services", "workers"))
        bytecode = str(self.scratch / "bytecode")  # as an installed package has it, whatever the shell says of writing it
        environment = {**os.environ, "PYTHONPATH": paths, "PYTHONPYCACHEPREFIX": bytecode, "PYTHONDONTWRITEBYTECODE": ""}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        run = subprocess.run([sys.executable, *map(str, words)], env=environment, capture_output=True, text=True, check=False)
        if run.returncode:
            raise SystemExit(f"{self.name}: {' '.join(map(str, words))} failed:\n{run.stderr[-2000:]}")
        return run.stdout

    def wayloom(self, *words: str | Path) -> None:
        """Run a command of the tree's own."""
        self.call("-c", "from wayloom.cli.main import main; main()", *words)

    def network(self, name: str) -> str:
        """What `--model` takes: EfficientViT is converted by the tree itself, since its file is the converter's."""
        if name != "efficientvit-b0":
            return name
        onnx = self.scratch / "efficientvit-b0.onnx"
        if not onnx.exists():
            weights = Path(os.environ.get("WAYLOOM_MODELS", ROOT.parent / "shared" / "models")) / WEIGHTS
            self.wayloom("models", "convert", name, weights, "--out", onnx)
        return str(onnx.with_suffix(".toml"))


def cases(drives: list[str], networks: list[str], data: Path, scratch: Path) -> list[Case]:
    fixes = data / "kitti_oxts" / "2011_10_03" / "2011_10_03_drive_0027_sync"
    logs = {
        "A": (data / "kitti_odometry" / "sequences" / "00", fixes),
        "B": (data / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync", None),
        "city": (scratch / "city" / "car-1", None),
    }
    return [Case(drive, network, *logs[drive]) for drive in drives for network in networks]


@contextmanager
def revision(name: str, scratch: Path) -> Iterator[Tree]:
    """A committed state of the repository, checked out beside it."""
    folder = scratch / "tree"
    subprocess.run(["git", "-C", ROOT, "worktree", "add", "--detach", "--quiet", folder, name], check=True)
    try:
        yield Tree(name, folder, _made(scratch / "before"))
    finally:
        subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", folder], check=True)


def measure(tree: Tree, case: Case, cores: int) -> Measured:
    """One run of a case, whose results are removed."""
    with tempfile.TemporaryDirectory(dir=tree.scratch) as out:
        words = [ROOT / "benchmarks" / "drive_cost.py", case.log, Path(out) / "drive", "--cores", str(cores)]
        words += ["--model", tree.network(case.network), *(("--gnss", case.gnss) if case.gnss else ())]
        found: Measured = json.loads(tree.call(*words))
    return found


def best(runs: list[Measured]) -> Measured:
    """Of each stage the least CPU and wall seconds of several runs; the rest is the first run's."""
    first = runs[0]
    stages = {
        name: {**stage, **{key: min(run["stages"][name][key] for run in runs) for key in ("cpu_s", "wall_s")}}
        for name, stage in first["stages"].items()
    }
    return {**first, "stages": stages}


def cost_table(by_cores: dict[int, Measured]) -> str:
    """One row a stage: of a run on one core, beside the wall seconds and peak memory of a run on two."""
    one = by_cores[min(by_cores)]
    km, frames, total = one["metres"] / 1000, one["frames"], one["stages"]["all"]["cpu_s"]
    walls = "".join(f" wall ms a frame, {cores} core{'s' if cores > 1 else ''} |" for cores in by_cores)
    peaks = "".join(f" peak MB, {cores} core{'s' if cores > 1 else ''} |" for cores in by_cores)
    lines = [
        f"| stage | share of CPU | CPU ms a frame | CPU s a km |{walls}{peaks} MB read a km | MB written a km | MB kept a km |",
        f"| --- | --- | --- | --- |{' --- |' * 2 * len(by_cores)} --- | --- | --- |",
    ]
    for name, stage in one["stages"].items():
        wall = " | ".join(f"{1000 * run['stages'][name]['wall_s'] / frames:.1f}" for run in by_cores.values())
        peak = " | ".join(f"{run['stages'][name]['peak'] / 1e6:.0f}" for run in by_cores.values())
        cpu = f"{100 * stage['cpu_s'] / total:.1f} % | {1000 * stage['cpu_s'] / frames:.1f} | {stage['cpu_s'] / km:.1f}"
        bytes_ = " | ".join(f"{stage[key] / 1e6 / km:.1f}" for key in ("read", "written", "kept"))
        lines.append(f"| {name} | {cpu} | {wall} | {peak} | {bytes_} |")
    return "\n".join(lines)


def ratio_table(before: Measured, after: Measured, name: str) -> str:
    """CPU of each stage of two trees in one run."""
    lines = [f"| stage | CPU ms a frame at {name} | now | ratio |", "| --- | --- | --- | --- |"]
    for stage, now in after["stages"].items():
        was = before["stages"].get(stage)
        if was and was["cpu_s"] > 0.02:
            values = f"{1000 * was['cpu_s'] / before['frames']:.1f} | {1000 * now['cpu_s'] / after['frames']:.1f}"
            lines.append(f"| {stage} | {values} | {now['cpu_s'] / was['cpu_s']:.2f} |")
    return "\n".join(lines)


def measured_case(trees: list[Tree], case: Case, cores: list[int], rounds: int) -> dict[str, dict[int, Measured]]:
    """Of each tree and number of cores the best of the rounds; trees take turns. All but the first run on the fewest cores only."""
    runs: dict[str, dict[int, list[Measured]]] = {
        tree.name: {count: [] for count in (cores if tree is trees[0] else [min(cores)])} for tree in trees
    }
    for _ in range(rounds):
        for count in cores:
            for tree in (tree for tree in trees if count in runs[tree.name]):
                runs[tree.name][count].append(measure(tree, case, count))
                print(f"{case.drive}, {case.network}, {count} cores, {tree.name}: done", file=sys.stderr)
    return {name: {count: best(found) for count, found in by_cores.items()} for name, by_cores in runs.items()}


def write_shares(tree: Tree, clip: Path, gnss: Path, pairs: int) -> None:
    """benchmarks/cost.json from runs over the first SHARE_FRAMES frames of clip A with the network that ships."""
    log = tree.scratch / "first"
    for side in ("image_0", "image_1"):
        (log / side).mkdir(parents=True)
        for image in sorted((clip / side).glob("*.png"))[:SHARE_FRAMES]:
            (log / side / image.name).write_bytes(image.read_bytes())
    (log / "calib.txt").write_bytes((clip / "calib.txt").read_bytes())
    (log / "times.txt").write_text("".join((clip / "times.txt").read_text().splitlines(keepends=True)[:SHARE_FRAMES]))
    case = Case("A", "wayloom-city", log, gnss)
    measure(tree, case, 1)
    shares: dict[str, list[float]] = {}
    for _ in range(pairs):
        stages = best([measure(tree, case, 1) for _ in range(2)])["stages"]
        total = sum(stage["cpu_s"] for name, stage in stages.items() if name != "all")
        for name, stage in stages.items():
            if name != "all":
                shares.setdefault(name, []).append(stage["cpu_s"] / total)
    content = {
        "shares": {name: round(statistics.median(found), 4) for name, found in shares.items()},
        "noise": {name: round(max(found) - min(found), 4) for name, found in shares.items()},
    }
    SHARES.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def told(case: Case, trees: list[Tree], found: dict[str, dict[int, Measured]]) -> str:
    now = found[trees[0].name]
    one = now[min(now)]
    parts = [
        f"### {case.drive}, {case.network}: {one['frames']} frames, {one['keyframes']} keyframes, {one['metres']:.0f} m",
        cost_table(now),
    ]
    for other in trees[1:]:
        parts.append(ratio_table(found[other.name][min(now)], one, other.name))
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", nargs="+", choices=["A", "B", "city"], default=["A", "B", "city"])
    parser.add_argument("--networks", nargs="+", default=["wayloom-city", "efficientvit-b0"])
    parser.add_argument("--cores", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--against", metavar="REVISION")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument("--scratch", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--shares", type=int, metavar="PAIRS")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scratch = args.scratch or Path(folder)
        here = Tree("this tree", ROOT, _made(scratch / "now"))
        if args.shares:
            case = cases(["A"], ["wayloom-city"], args.data, scratch)[0]
            assert case.gnss
            write_shares(here, case.log, case.gnss, args.shares)
            return
        if "city" in args.drives and not (scratch / "city").exists():
            here.wayloom("simulate", "loop", "--size", "full", "--out", scratch / "city")
        with _trees(here, args.against, scratch) as trees:
            wanted = cases(args.drives, args.networks, args.data, scratch)
            for tree in trees:
                measure(tree, wanted[0], 1)  # compiles the kernels
            found = {f"{case.drive} {case.network}": measured_case(trees, case, args.cores, args.rounds) for case in wanted}
    rounds = "one round" if args.rounds == 1 else f"the least of {args.rounds} rounds"
    load = f"{os.cpu_count()} cores, load average {os.getloadavg()[2]:.1f}, {rounds}."
    text = "\n\n".join([load, *(told(case, trees, found[f"{case.drive} {case.network}"]) for case in wanted)])
    print(text)
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if args.write:
        put_between_marks(PAGE, "cost", text + "\n")


@contextmanager
def _trees(here: Tree, against: str | None, scratch: Path) -> Iterator[list[Tree]]:
    if against is None:
        yield [here]
        return
    with revision(against, scratch) as before:
        yield [here, before]


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    main()
