"""Peer programs run on the same recording: the prototype, and other odometries that are installed."""

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ConfigError, InputError, LogError
from wayloom.evaluation.odometry import Numbers, Summary, run_measured, summarise
from wayloom.evaluation.odometry_recordings import Recording
from wayloom.evaluation.trajectory import evaluate
from wayloom.files.trajectory_files import read_kitti, read_tum
from wayloom.logs.kitti import kitti_odometry
from wayloom.logs.kitti.image_folder_log import ImageFolderLog
from wayloom.logs.types import DriveLog

FloatArray = NDArray[np.float64]
PROTOTYPE = "prototype"
RUN_PROTOTYPE = """
import dataclasses, json, os, sys
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"
sys.path.insert(0, sys.argv[1])
import cv2, numpy, odometry
cv2.setNumThreads(1)
log, settings = odometry.StereoLog(sys.argv[2]), odometry.PRESETS[sys.argv[4]]
odometry.run(log, dataclasses.replace(settings, keyframe_flow=0.0, window=2), min(4, len(log.left)))
runs = []
for i, seed in enumerate(json.loads(sys.argv[5])):
    tracked, _, _, total = odometry.run(log, dataclasses.replace(settings, seed=seed), len(log.left))
    numpy.savetxt(f"{sys.argv[3]}/{i}.txt", tracked.trajectory()[:, :3].reshape(-1, 12), fmt="%.9e")
    runs.append({"keyframes": tracked.keyframes, "bias px": tracked.bias, "cpu mean ms": 1e3 * total / len(log.left)})
print(json.dumps(runs))
"""


def kitti_folder(log: DriveLog, scratch: Path) -> Path:
    """The log as a folder in KITTI odometry layout with image_0 and image_1: itself, or links in `scratch`.

    Raises InputError for a log whose images are no plain rectified files.
    """
    if log.format == kitti_odometry.FORMAT:
        return log.path
    if not isinstance(log, ImageFolderLog) or log.rectifier is not None:
        raise InputError("has no rectified image files", file=log.path, remedy="peers are given folders of images")
    for name, files in (("image_0", log.pairs.left), ("image_1", log.pairs.right)):
        (scratch / name).mkdir()
        for i, file in enumerate(files):
            (scratch / name / f"{i:06d}{file.suffix}").symlink_to(file)
    P = np.column_stack([log.rig.camera.K, np.zeros(3)])
    Q = P.copy()
    Q[0, 3] = -log.rig.bf
    lines = [f"{name}: {' '.join(f'{x:.12g}' for x in M.ravel())}\n" for name, M in (("P0", P), ("P1", Q))]
    (scratch / "calib.txt").write_text("".join(lines))
    seconds = 1e-9 * (log.t_ns - log.t_ns[0])
    (scratch / "times.txt").write_text("".join(f"{t:.6f}\n" for t in seconds))
    return scratch


def errors_of(recording: Recording, T_world_cam: FloatArray) -> Numbers:
    """The accuracy of a trajectory (N, 4, 4) under the names that the product's own has."""
    numbers: Numbers = {"frames": len(recording.log), "tracked": len(T_world_cam)}
    if len(T_world_cam) != len(recording.log):
        return numbers
    for name, truth in recording.truths.items():
        errors = evaluate(T_world_cam, truth)
        numbers |= {
            f"ATE m ({name})": errors.ate_m, f"t_rel % ({name})": errors.t_rel_percent,
            f"r_rel deg/100 m ({name})": errors.r_rel_deg_per_100m, f"frame mm ({name})": 1e3 * errors.frame_translation_m,
            f"length ratio ({name})": errors.length_ratio,
        }  # fmt: skip
    return numbers


def prototype_measured(
    recording: Recording, prototypes: Path, seeds: Sequence[int], cache: Path, preset: str = "fast"
) -> Summary | None:
    """The prototype in `prototypes`/direct-odometry on a recording; None where it is not there. cache : for its kernels.

    Raises InputError, with what it said last, where it fails.
    """
    place = prototypes / "direct-odometry"
    if not (place / "odometry.py").is_file():
        return None
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        (scratch / "log").mkdir()
        (scratch / "poses").mkdir()
        folder = kitti_folder(recording.log, scratch / "log")
        command = [
            sys.executable,
            "-c",
            RUN_PROTOTYPE,
            str(place),
            str(folder),
            str(scratch / "poses"),
            preset,
            json.dumps(list(seeds)),
        ]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
            raise InputError(f"the prototype failed: {said}", file=folder, remedy="leave it out")
        runs = json.loads(done.stdout.strip().splitlines()[-1])
        for i, run in enumerate(runs):
            run |= errors_of(recording, read_kitti(scratch / "poses" / f"{i}.txt"))
    return summarise(recording.name, f"{PROTOTYPE}, {preset}", runs)


def peer_measured(recording: Recording, command: str) -> Summary:
    """A peer run once; its CPU time includes its start.

    command : with {log}, a folder in KITTI odometry layout, and {out}, the file for its poses, one a frame in KITTI or TUM format
    Raises ConfigError for a command without both, InputError where the peer fails.
    """
    if "{log}" not in command or "{out}" not in command:
        raise ConfigError(f"the peer's command {command!r} lacks {{log}} or {{out}}", remedy="put both where its arguments are")
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        (scratch / "log").mkdir()
        folder, out = kitti_folder(recording.log, scratch / "log"), scratch / "poses.txt"
        words = [word.replace("{log}", str(folder)).replace("{out}", str(out)) for word in shlex.split(command)]
        status, cpu_s, peak_mb = run_measured(words)
        if status or not out.is_file():
            raise InputError(f"the peer ended with status {status} and {'no' if not out.is_file() else 'some'} poses", file=folder)
        numbers = errors_of(recording, read_poses(out))
    numbers["cpu mean ms"] = 1e3 * cpu_s / len(recording.log)
    numbers["peak memory MB"] = peak_mb
    return summarise(recording.name, words[0].rsplit("/", 1)[-1], [numbers])


def read_poses(file: Path) -> FloatArray:
    """(N, 4, 4) of a KITTI (12 numbers a line) or TUM (8) file."""
    lines = [line for line in file.read_text().splitlines() if line and not line.startswith("#")]
    if not lines:
        raise LogError("holds no pose", file=file)
    return read_tum(file)[1] if len(lines[0].split()) == 8 else read_kitti(file)
