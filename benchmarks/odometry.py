"""The odometry's accuracy, times, density and depths on every recording, what each of its parts is worth, and other programs
on the same recordings in the same run.

    python benchmarks/odometry.py [--data FOLDER] [--drive FOLDER …] [--simulate PRESET[:SIZE[:DRIVES]] …] [--seeds 5]
                                  [--ablations [NAME …]] [--ablation-seeds 2] [--peer COMMAND …] [--json FILE] [--write]
                                  [--kernels-only]

--data      the recordings as docs/results.md describes them; default is what WAYLOOM_DATA names, else ../shared/data
--drive     more drives with their own poses (and truth images), as `wayloom simulate --truth` writes them
--simulate  presets of `wayloom simulate` that are made where they do not yet lie in the cache folder; size is half unless
            said, drives all: rig:full:lens-1,perfect-1
--piece     also pieces of recordings: A:16:67 for frames 16 to 66 of A, which is then the recording `A 16:67`
--only      recordings of these names
--ablations also runs for each part left out, of these recordings, all where none is named
--peer      a program to compare with: its command with {log} (KITTI odometry layout) and {out} (poses)
--write     the numbers into benchmarks/odometry.json, to which a test holds the odometry, and all of these as tables into
            docs/benchmarks/odometry.md; rows that are not measured again stay as they are

The prototype is looked for in WAYLOOM_PROTOTYPES (default ../shared/prototypes); without it its rows are left out.
CPU times are those of one thread, images decoded within them, kernels compiled or loaded before.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "core"), str(ROOT / "tests" / "odometry")]

import cv2  # noqa: E402
import naive  # noqa: E402
import numpy as np  # noqa: E402
from made_window import NUMBERS, ROBUST, made_window  # noqa: E402

from pages import DOCS  # noqa: E402
from wayloom.errors import InputError, WayloomError  # noqa: E402
from wayloom.evaluation import odometry_peers, odometry_table  # noqa: E402
from wayloom.evaluation.odometry import ABLATIONS, DEFAULT, SEEDS, Summary, joined, measured, peak_memory_mb, replaced, warm_up  # noqa: E402
from wayloom.evaluation.odometry_recordings import Recording, clip_recordings, piece, recording_of  # noqa: E402
from wayloom.geometry import se3  # noqa: E402
from wayloom.geometry.camera import PinholeCamera, StereoRig  # noqa: E402
from wayloom.odometry.kernels import adjustment, equations, linear, patch, resampling, tracking_equations  # noqa: E402
from wayloom.odometry.kernels.compiler import opened  # noqa: E402
from wayloom.odometry.rig import rows  # noqa: E402
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate  # noqa: E402

PAGE, NUMBERS_FILE = DOCS / "benchmarks" / "odometry.md", ROOT / "benchmarks" / "odometry.json"


def say(share: float, what: str) -> None:
    """Progress, to stderr."""
    sys.stderr.write(f"odometry benchmark: {what}\n")


def recordings(options: argparse.Namespace) -> list[Recording]:
    """The clips, the given drives and the simulated ones, those of them that were asked for."""
    found = clip_recordings(options.data) if options.data.is_dir() else []
    found += [recording_of(folder) for folder in options.drive]
    for wanted in options.simulate:
        preset, size, drives = (*wanted.split(":"), "", "")[:3]
        for folder in simulated(preset, size or "half", tuple(filter(None, drives.split(","))), options.cache):
            found.append(recording_of(folder, f"{preset} {folder.name}{f', {size}' if size else ''}"))
    for wanted in options.piece:
        name, first, stop = wanted.rsplit(":", 2)
        found += [piece(recording, int(first), int(stop)) for recording in found if recording.name == name]
    return [recording for recording in found if not options.only or recording.name in options.only]


def simulated(preset: str, size: str, drives: tuple[str, ...], cache: Path) -> list[Path]:
    """The folders of a preset's drives (all where none is named) in the cache, made where they are not yet there."""
    folder = cache / "-".join((preset, size, *drives))
    if not folder.is_dir():
        unfinished = cache / f"{folder.name}.unfinished-{os.getpid()}"
        simulate(
            preset,
            unfinished,
            OutputSettings(size=size, truth=True),
            PresetVariant(drives=drives),
            progress=lambda share, what: None,
        )
        unfinished.rename(folder)
    return sorted(path for path in folder.iterdir() if path.is_dir())


def measured_all(options: argparse.Namespace, cache: Path) -> list[Summary]:
    """Every recording with the product, its ablations, the prototype and the peers. cache : of the prototype's kernels."""
    prototypes = Path(os.environ.get("WAYLOOM_PROTOTYPES", ROOT / "../shared/prototypes"))
    seeds, found = SEEDS[: options.seeds], []
    for recording in recordings(options):
        warm_up(recording)
        own, *prototype = in_turn(recording, prototypes, seeds, cache)
        own.median["peak memory MB"], own.spread["peak memory MB"] = peak_memory_mb(recording.log.path), 0.0
        found += [own, *prototype]
        for command in options.peer:
            found += foreign(partial(odometry_peers.peer_measured, recording, command))
        if options.ablations is not None and recording.name in (options.ablations or [recording.name]):
            found += [measured(recording, variant, SEEDS[: options.ablation_seeds], say) for variant in ABLATIONS]
    return found


def in_turn(recording: Recording, prototypes: Path, seeds: Sequence[int], cache: Path) -> list[Summary]:
    """The product and, where it is there, the prototype, one after the other seed by seed: what slows a shared machine for a while
    slows both, and the share of the prototype's time is the median of the pairs'."""
    own, prototype = [], []
    for seed in seeds:
        own.append(measured(recording, seeds=(seed,), progress=say))
        prototype += foreign(partial(odometry_peers.prototype_measured, recording, prototypes, (seed,), cache))
    if len(prototype) < len(own):
        return [joined(own)]
    for ours, theirs in zip(own, prototype, strict=True):
        ours.median[odometry_table.CPU_SHARE] = ours.median["cpu mean ms"] / theirs.median["cpu mean ms"]
    return [joined(own), joined(prototype)]


def foreign(other: Callable[[], Summary | None]) -> list[Summary]:
    """What another program gives; where it fails that is said and no more."""
    try:
        summary = other()
    except InputError as problem:
        say(0.0, str(problem))
        return []
    return [] if summary is None else [summary]


def read_numbers(file: Path) -> list[Summary]:
    """The summaries that a file holds; none where there is no file yet."""
    return [Summary.from_json(row) for row in json.loads(file.read_text())] if file.is_file() else []


def write_numbers(file: Path, summaries: Sequence[Summary]) -> None:
    """The summaries as a JSON list."""
    file.write_text(json.dumps([summary.as_json() for summary in summaries], indent=1) + "\n")


def best_ms(work: Callable[[], object], repeats: int) -> float:
    """Least CPU time in ms of one call, over five rounds of `repeats` calls."""
    work()
    rounds = []
    for _ in range(5):
        start = time.process_time()
        for _ in range(repeats):
            work()
        rounds.append(1e3 * (time.process_time() - start) / repeats)
    return min(rounds)


def row_alignment_ms() -> tuple[float, float]:
    """A right image's rows aligned by our kernel, and by OpenCV with maps made before."""
    rig, image = StereoRig(PinholeCamera(718.9, 718.9, 607.2, 185.2, 1241, 376), (-0.54, 0.0, 0.0)), np.zeros((376, 1241), np.uint8)
    corners = rows.displacements(np.array([0.9, 0.4, 0.7]), rig)
    size = (corners.shape[1] * resampling.STEP, corners.shape[0] * resampling.STEP)
    moved = cv2.resize(corners, size)[:376, :1241]
    v, u = np.mgrid[0:376, 0:1241].astype(np.float32)
    maps = cv2.convertMaps(u + moved[..., 0], v + moved[..., 1], cv2.CV_16SC2)
    cv2.setNumThreads(1)
    return best_ms(lambda: rows.align(image, corners), 20), best_ms(lambda: cv2.remap(image, *maps, cv2.INTER_CUBIC), 20)


def kernel_table() -> None:
    """Kernels against the twins that the tests check them with."""
    window = made_window(4, 100)
    points, frames = window.points, window.frames
    image, T = window.images.left[1], linear.relative(frames.T_cam_world[1], frames.T_cam_world[0])
    x, y = (points.uv[0] - (NUMBERS.cx, NUMBERS.cy)) / (NUMBERS.fx, NUMBERS.fy)
    one = (image, T, x, y, points.rho[0], NUMBERS, 0.0, points.colour[0], points.weight[0], 1.0, 0.0, ROBUST)
    patch_scratch = patch.make_scratch()
    grey = image.astype(np.float32)
    rays = np.column_stack([(points.uv - (NUMBERS.cx, NUMBERS.cy)) / (NUMBERS.fx, NUMBERS.fy), points.rho, points.colour[:, 4]])
    camera, space = np.array(NUMBERS[:4]), (np.zeros((8, 8)), np.zeros(8), *tracking_equations.working_space())
    patch_residual, tracked = opened(patch.patch_residual), opened(tracking_equations.tracking_equations)
    xi = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    table = [
        (
            "patch_residual",
            best_ms(lambda: patch_residual(*one, patch_scratch), 2000),
            best_ms(lambda: naive.patch_terms(*one), 20),
        ),
        (
            "tracking_equations, 400 points",
            best_ms(lambda: tracked(grey, rays, T, 1.0, 0.0, camera, 9.0, 20.0, *space), 200),
            best_ms(lambda: naive.tracking_equations(grey, rays, T, 1.0, 0.0, camera, 9.0, 20.0), 2),
        ),
        ("exp_se3", best_ms(lambda: linear.exp_se3(xi), 2000), best_ms(lambda: se3.exp(xi), 200)),
        ("rows of an image of 1241 x 376 px, against OpenCV", *row_alignment_ms()),
    ]
    print("\n| kernel | ms | naive twin ms | ratio |\n| --- | --- | --- | --- |")
    for name, fast, slow in table:
        print(f"| {name} | {fast:.4f} | {slow:.3f} | {slow / fast:.0f} |")
    terms = adjustment.make_terms(len(points.rho), len(window))
    residuals = int(terms.inlier.size)
    linearised = best_ms(lambda: equations.linearise(window.images, NUMBERS, frames, points, 0.3, ROBUST, terms), 20)
    print(f"| linearise, 4 keyframes, 400 points | {linearised:.3f} | | {1e3 * linearised / residuals:.2f} µs a residual slot |")


def arguments() -> argparse.ArgumentParser:
    """What can be asked for."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wayloom" / "benchmark-drives"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument("--drive", type=Path, nargs="+", default=[], metavar="FOLDER")
    parser.add_argument("--simulate", nargs="+", default=[], metavar="PRESET")
    parser.add_argument("--cache", type=Path, default=cache, help="of simulated drives")
    parser.add_argument("--piece", nargs="+", default=[], metavar="NAME:FIRST:STOP")
    parser.add_argument("--only", nargs="+", metavar="NAME")
    parser.add_argument("--seeds", type=int, choices=range(1, len(SEEDS) + 1), default=len(SEEDS))
    parser.add_argument("--ablations", nargs="*", metavar="NAME")
    parser.add_argument("--ablation-seeds", type=int, choices=range(1, len(SEEDS) + 1), default=2)
    parser.add_argument("--peer", nargs="+", default=[], metavar="COMMAND")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--kernels-only", action="store_true")
    return parser


def main() -> None:
    """Measure, print, and where asked for write."""
    options = arguments().parse_args()
    if not options.kernels_only:
        try:
            with tempfile.TemporaryDirectory() as cache:
                summaries = measured_all(options, Path(cache))
        except WayloomError as problem:
            sys.exit(f"odometry benchmark: {problem}")
        print(odometry_table.page(summaries))
        own = [summary for summary in summaries if summary.variant == DEFAULT]
        print("\n".join(["**Parts, wall ms a frame**", "", *odometry_table.parts_table(own)]))
        if options.json is not None:
            write_numbers(options.json, summaries)
        if options.write:
            write_numbers(NUMBERS_FILE, replaced(read_numbers(NUMBERS_FILE), summaries))
            PAGE.write_text(odometry_table.page(read_numbers(NUMBERS_FILE)), encoding="utf-8")
    kernel_table()


if __name__ == "__main__":
    main()
