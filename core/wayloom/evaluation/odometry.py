"""Odometry benchmark of one recording: what `benchmarks/odometry.py` puts in its table.

One run gives a flat dict of numbers; a few runs that differ in nothing but the seed of the choice of points give each number's
median and spread. Differences below the spread mean nothing.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.self_calibration import calibrate_drive, track_calibrated
from wayloom.config.progress import Progress, silent
from wayloom.evaluation.odometry_density import density
from wayloom.evaluation.odometry_depth import depth_errors
from wayloom.evaluation.odometry_recordings import Recording, Thinned, thinned
from wayloom.evaluation.trajectory import evaluate, path_length, relative_errors, stretches
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
Numbers = dict[str, float]
SEEDS = (0, 1, 2, 3, 4)
WARM_UP_FRAMES = 12
POLL_S = 0.02
DRIFT_STRETCH_M = 100.0
DEFAULT = "wayloom"
EVERY_SECOND_FRAME = "every second frame dropped"
NOTHING_CALIBRATED: dict[str, Any] = {"row_frames": (), "bias_prior": 1e15, "self_calibration": False}
ABLATIONS: dict[str, dict[str, Any]] = {
    "no static stereo terms": {"static_weight": 0.0, "observer_right_weight": 0.0},
    "no observers' right images": {"observer_right_weight": 0.0},
    "no self-calibration": NOTHING_CALIBRATED,
    "no lens of the drive's own": {"self_calibration": False},
    "no disparity bias": {"bias_prior": 1e15},
    "disparity bias free at once": {"bias_gate": 0.0},
    "no rows": {"row_frames": ()},
    "bias not in the prior": {"ablation": {"bias_in_prior": False}},
    "no marginalisation prior": {"ablation": {"marginalisation_prior": False}},
    "no first-estimate Jacobians": {"ablation": {"first_estimates": False}},
    "no epipolar search": {"traced_share": 0.0, "sought_points": 0},
    "no epipolar search, fewer waiting points": {"traced_share": 0.0, "sought_points": 0, "matched_points": 0},
    "no gradient weight": {"gradient_scale": 1e6},
    "no affine brightness in the window": {"affine_prior": (1e9, 1e9)},
    "one step a window": {"adjust_iterations": 1},
    "three steps a window": {"adjust_iterations": 3},
    EVERY_SECOND_FRAME: {},
}
"""Name of a column to the settings that differ from the default's."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Median of each number over the runs, and the largest minus the smallest."""

    recording: str
    variant: str
    runs: int
    median: Numbers
    spread: Numbers

    def as_json(self) -> dict[str, Any]:
        """NaN becomes None."""
        groups = {name: {key: _json(value) for key, value in getattr(self, name).items()} for name in ("median", "spread")}
        return {**asdict(self), **groups}

    @classmethod
    def from_json(cls, row: Mapping[str, Any]) -> "Summary":
        """What `as_json` gave; None becomes NaN."""
        median, spread = ({key: _number(value) for key, value in row[name].items()} for name in ("median", "spread"))
        return cls(row["recording"], row["variant"], row["runs"], median, spread)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _json(value: float) -> float | None:
    return round(value, 6) if np.isfinite(value) else None


def timed_track(recording: Recording, settings: OdometrySettings) -> tuple[OdometryResult, FloatArray]:
    """The result of one thread, and the CPU time (N - 1,) ms of each frame but the first, images decoded within it.

    The first frame's time is that of loading kernels and of fitting rows: it is left out. Learning the drive's own lens comes
    before it; `measures` adds it to the mean.
    """
    marks: list[float] = []
    result = track_calibrated(recording.log, settings, lambda share, what: marks.append(time.process_time()))
    frames = len(recording.log)
    return result, 1e3 * np.diff(marks[-frames:])


def measures(recording: Recording, result: OdometryResult, cpu_ms: FloatArray) -> Numbers:
    """All numbers of one run; of truth `name` under `ATE m (name)` and so on."""
    trajectory, way = result.trajectory, path_length(result.trajectory.T_world_cam[:, :3, 3])
    numbers: Numbers = {
        "frames": len(trajectory),
        "tracked": int(trajectory.tracked.sum()),
        "segments": len(np.unique(trajectory.segment)),
        "keyframes": len(result.keyframes),
        "bias px": result.disparity_bias_px,
        "cpu median ms": float(np.median(cpu_ms)),
        "cpu mean ms": float(np.mean(cpu_ms)) + 1e3 * result.report["seconds"].get("own lens", 0.0) / len(trajectory),
        "cpu p95 ms": float(np.percentile(cpu_ms, 95)),
    }
    for name, truth in recording.truths.items():
        errors = evaluate(trajectory.T_world_cam, truth)
        numbers |= {
            f"ATE m ({name})": errors.ate_m,
            f"t_rel % ({name})": errors.t_rel_percent,
            f"r_rel deg/100 m ({name})": errors.r_rel_deg_per_100m,
            f"frame mm ({name})": 1e3 * errors.frame_translation_m,
            f"frame mdeg ({name})": 1e3 * errors.frame_rotation_deg,
            f"length ratio ({name})": errors.length_ratio,
        } | drift(trajectory.T_world_cam, truth)
    dense = density(result, recording.log, way)
    numbers |= {"points/m": dense.points_per_m, "blocks covered": dense.blocks_covered, "horizontal edges": dense.horizontal_edges}
    if recording.depth is not None:
        numbers |= {
            f"depth {name}": float(value)
            for name, value in asdict(depth_errors(result, recording.depth, recording.numbers)).items()
        }
    seconds: Mapping[str, float] = result.report["seconds"]
    return numbers | {f"part {part} ms": 1e3 * value / len(trajectory) for part, value in seconds.items()}


def drift(T_world_cam: FloatArray, truth: FloatArray) -> Numbers:
    """Of a drive of two kilometres and more: its way, and its mean translation error over 100 m in the first and the last one."""
    if not np.isfinite(truth).all():
        return {}
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    if travelled[-1] < 2e3:
        return {}
    pairs = stretches(truth, DRIFT_STRETCH_M)
    error = 100.0 * relative_errors(T_world_cam, truth, pairs)[0] / DRIFT_STRETCH_M
    starts = travelled[pairs[:, 0]]
    ends = {"first": starts < 1e3, "last": starts > starts[-1] - 1e3}
    return {"way km": 1e-3 * travelled[-1]} | {f"t_rel % {name} km": float(error[those].mean()) for name, those in ends.items()}


def summarise(recording: str, variant: str, runs: Sequence[Numbers]) -> Summary:
    """Median and spread over runs; numbers that a run lacks are NaN there and left out of both."""
    names = list(dict.fromkeys(name for run in runs for name in run))
    table = np.array([[run.get(name, np.nan) for name in names] for run in runs], dtype=float).reshape(len(runs), len(names))
    median, spread = {}, {}
    for name, column in zip(names, table.T, strict=True):
        known = column[np.isfinite(column)]
        median[name] = float(np.median(known)) if len(known) else float("nan")
        spread[name] = float(np.ptp(known)) if len(known) else float("nan")
    return Summary(recording, variant, len(runs), median, spread)


def joined(summaries: Sequence[Summary]) -> Summary:
    """One of several of the same recording and variant, of a run each."""
    return summarise(summaries[0].recording, summaries[0].variant, [summary.median for summary in summaries])


def measured(recording: Recording, variant: str = DEFAULT, seeds: Sequence[int] = SEEDS, progress: Progress = silent) -> Summary:
    """The recording tracked once for each seed with a variant's settings: DEFAULT or a key of ABLATIONS."""
    changes = {} if variant == DEFAULT else ABLATIONS[variant]
    seen = thinned(recording, 2) if variant == EVERY_SECOND_FRAME else recording
    runs = []
    for i, seed in enumerate(seeds):
        progress(i / len(seeds), f"{recording.name}, {variant}, seed {seed}")
        settings = OdometrySettings.model_validate({**changes, "seed": seed})
        runs.append(measures(seen, *timed_track(seen, settings)))
    return summarise(recording.name, variant, runs)


def replaced(committed: Sequence[Summary], new: Sequence[Summary]) -> list[Summary]:
    """The committed rows, those of them that were measured again replaced in their place, and the new ones behind them."""
    rows = {(row.recording, row.variant): row for row in committed} | {(row.recording, row.variant): row for row in new}
    return list(rows.values())


def warm_up(recording: Recording) -> None:
    """Load or compile every kernel, those for a drive's own lens too, so that no run is timed with it."""
    calibrate_drive(recording.log, OdometrySettings())
    kept = np.arange(0, len(recording.log), 2)[:WARM_UP_FRAMES]
    track_calibrated(Thinned(recording.log, kept), OdometrySettings(window=3))


def peak_memory_mb(log: Path) -> float:
    """Largest resident memory in MB of `wayloom odometry LOG` as a process of its own; NaN where it fails."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "wayloom.cli.main", "odometry", str(log), "--out", f"{scratch}/t.tum"]
        status, _, peak_mb = run_measured(command)
    return peak_mb if status == 0 else float("nan")


def run_measured(command: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[int, float, float]:
    """Exit status of a command, its CPU seconds with those of its children, and its own largest resident memory in MB, NaN where
    the system does not tell. What it says goes to stderr."""
    process, peak_mb = (
        subprocess.Popen(list(command), stdout=sys.stderr, env=None if environment is None else dict(environment)),
        0.0,
    )
    while True:
        peak_mb = max(peak_mb, high_water_mb(process.pid))
        ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        if ended:
            break
        time.sleep(POLL_S)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, usage.ru_utime + usage.ru_stime, peak_mb or float("nan")


def high_water_mb(pid: int) -> float:
    """VmHWM of a process. Not wait4's ru_maxrss: that counts the memory of whoever started the process, too."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:")), 0.0)
