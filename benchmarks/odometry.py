"""Times of the odometry: a whole clip beside the prototype in the same run, its parts, and kernels beside their naive twins.

    python benchmarks/odometry.py [LOG] [--frames 100] [--kernels-only]

The prototype is looked for in WAYLOOM_PROTOTYPES (default ../shared/prototypes); without it that row is left out. It reads KITTI
odometry folders with image_0 and image_1 only. CPU seconds of one thread; kernels are compiled or loaded before anything is timed.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[1]
CLIP_A = Path(os.environ.get("WAYLOOM_DATA", ROOT / "../shared/data")) / "kitti_odometry" / "sequences" / "00"
sys.path[:0] = [str(ROOT / "core"), str(ROOT / "tests" / "odometry")]

import naive  # noqa: E402
import numpy as np  # noqa: E402
from made_window import NUMBERS, ROBUST, made_window  # noqa: E402

from wayloom.geometry import se3  # noqa: E402
from wayloom.logs.registry import open_log  # noqa: E402
from wayloom.odometry import feed, pyramid  # noqa: E402
from wayloom.odometry.kernels import adjustment, equations, linear, patch, tracking  # noqa: E402
from wayloom.odometry.odometry import Odometry  # noqa: E402
from wayloom.odometry.settings import OdometrySettings  # noqa: E402


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


def run_clip(path: Path, frames: int) -> tuple[Odometry, float]:
    """The odometry after `frames` frames, and its CPU ms a frame, decoding included."""
    log = open_log(path)
    count = min(frames, len(log))
    odometry = Odometry(log.rig, feed.fit_rows(log, OdometrySettings().row_frames), OdometrySettings())
    start = time.process_time()
    for index in range(count):
        with odometry.stopwatch("decode"):
            frame = log.frame(index)
        odometry.process(frame)
    return odometry, 1e3 * (time.process_time() - start) / count


def clip_table(path: Path, frames: int) -> None:
    """One row for the product, one for the prototype on the whole clip, and the product's parts."""
    run_clip(path, 25)
    odometry, ms = run_clip(path, frames)
    count = len(odometry.harvest.frames)
    print("| whole clip | CPU ms a frame |\n| --- | --- |")
    print(f"| wayloom, {count} frames, {len(odometry.harvest.keyframes)} keyframes | {ms:.1f} |")
    prototype = Path(os.environ.get("WAYLOOM_PROTOTYPES", ROOT / "../shared/prototypes")) / "direct-odometry" / "odometry.py"
    if prototype.is_file():
        with tempfile.TemporaryDirectory() as scratch:
            environment = {**os.environ, "NUMBA_CACHE_DIR": scratch, "PYTHONDONTWRITEBYTECODE": "1"}
            command = [sys.executable, str(prototype), str(path), "--out", f"{scratch}/poses.txt"]
            said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        print(f"| prototype, fast preset: {said.splitlines()[0]} | {said.split('CPU ')[1].split(' ms')[0]} |")
    print("\n| part | wall ms a frame |\n| --- | --- |")
    for part, seconds in sorted(odometry.stopwatch.seconds.items(), key=lambda item: -item[1]):
        print(f"| {part} | {1e3 * seconds / count:.2f} |")


def kernel_table() -> None:
    """Kernels against the twins that the tests check them with."""
    window = made_window(4, 100)
    points, frames = window.points, window.frames
    image, T = window.images.left[1], linear.relative(frames.T_cam_world[1], frames.T_cam_world[0])
    x, y = (points.uv[0] - (NUMBERS.cx, NUMBERS.cy)) / (NUMBERS.fx, NUMBERS.fy)
    one = (image, T, x, y, points.rho[0], NUMBERS, 0.0, points.colour[0], points.weight[0], 1.0, 0.0, ROBUST)
    patch_scratch = patch.make_scratch()
    graded = pyramid.with_gradient(image.astype(np.float32))
    rays = np.column_stack([(points.uv - (NUMBERS.cx, NUMBERS.cy)) / (NUMBERS.fx, NUMBERS.fy), points.rho, points.colour[:, 4]])
    camera, H, g = np.array(NUMBERS[:4]), np.zeros((8, 8)), np.zeros(8)
    xi = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    rows = [
        (
            "patch_residual",
            best_ms(lambda: patch.patch_residual(*one, patch_scratch), 2000),
            best_ms(lambda: naive.patch_terms(*one), 20),
        ),
        (
            "tracking_equations, 400 points",
            best_ms(lambda: tracking.tracking_equations(graded, rays, T, 1.0, 0.0, camera, 9.0, 20.0, H, g), 200),
            best_ms(lambda: naive.tracking_equations(graded, rays, T, 1.0, 0.0, camera, 9.0, 20.0), 2),
        ),
        ("exp_se3", best_ms(lambda: linear.exp_se3(xi), 2000), best_ms(lambda: se3.exp(xi), 200)),
    ]
    print("\n| kernel | ms | naive twin ms | ratio |\n| --- | --- | --- | --- |")
    for name, fast, slow in rows:
        print(f"| {name} | {fast:.4f} | {slow:.3f} | {slow / fast:.0f} |")
    terms = adjustment.make_terms(len(points.rho), len(window))
    residuals = int(terms.inlier.size)
    linearised = best_ms(lambda: equations.linearise(window.images, NUMBERS, frames, points, 0.3, ROBUST, terms), 20)
    print(f"| linearise, 4 keyframes, 400 points | {linearised:.3f} | | {1e3 * linearised / residuals:.2f} µs a residual slot |")


def main() -> None:
    parser = argparse.ArgumentParser(description="times of the odometry")
    parser.add_argument("log", type=Path, nargs="?", default=CLIP_A, help="default: clip A of the folder that WAYLOOM_DATA names")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--kernels-only", action="store_true")
    options = parser.parse_args()
    if not options.kernels_only:
        clip_table(options.log, options.frames)
    kernel_table()


if __name__ == "__main__":
    main()
