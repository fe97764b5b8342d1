"""Errors of made city drives of 5 km by odometry, GNSS and loop closures.

python benchmarks/drive_graph.py [--seeds 3] [--write]

With --write the table is written to docs/benchmarks/drive_graph.md.
"""

import argparse
import dataclasses
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.pop(0)  # this folder: its georeference.py hides the package
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from georeference.made_city_drives import CITY_WAY, city_drive, closures_of, gnss_of, start_at, with_bursts, with_outages
from georeference.made_gnss_drives import MadeDrive
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.types import FixType, GnssTrack
from wayloom.loops.types import LoopClosures
from wayloom.simulation.sensors.gnss import SIGMA_M, SLOW_S, SLOW_SHARE

FloatArray = NDArray[np.float64]
OUTAGES_S = [60.0, 170.0, 290.0, 430.0]
BURSTS = [
    (20.0, 6.0, [4.0, -3.0, 2.0]),
    (130.0, 10.0, [-8.0, 5.0, 3.0]),
    (250.0, 8.0, [2.0, 2.0, -1.0]),
    (480.0, 12.0, [6.0, 1.0, 9.0]),
]
REPORT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "drive_graph.md"
HEAD = """# Drive graph benchmark

Written whole by `python benchmarks/drive_graph.py --write`. Made city drives of {length:.2f} km: a way along streets that drives
300 m of its first street twice, and comes home along 550 m of it in the other direction; odometry with the white errors of
[decision 8](../decisions/0008-the-odometrys-scale-is-a-state.md), 5 mm and 0.02 degrees a root metre, and a scale that wanders
over 100 m, by the share in the second column: 0.2 % as measured on simulated drives, 2 % as on the worst real ones. The graph's
settings are the default ones. A closure every 10 m of road driven again, good to 5 cm and 0.1 degrees. Fixes have the simulator's
noise: RTK 2 cm, single point 1.6 m in east and in north, up more, half of the variance correlated over 8 s. Four outages of 30 s,
four bursts of 3 to 11 m. False closures join places that have nothing in common, in rows of three. Errors are of the position, in
three dimensions, m: median over {seeds} seeds, and the worst. Without GNSS the first frame is true, and so it is for the odometry
alone. NEES / 3 is of all frames; 1 is honest, less is careful. Times are of one thread, on a busy machine.

What single point fixes allow: were the odometry without error, so that only place and attitude of the whole drive were left to
them, the best unbiased estimate that knows their noise would still be off by {bound:.2f} m rms, in three dimensions, {level:.2f} m
of it level. Correlated over 8 s, 530 s of fixes are but 33 independent ones to half of the variance.

| GNSS | scale | closures | system | rms m | in outages m | end m | end % | NEES / 3 | used, refused | s |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""


@dataclass(frozen=True)
class Case:
    """A row of the table."""

    gnss: str
    closures: str
    system: str
    scale_sigma: float = 0.002


RTK = "RTK, outages, bursts"
CASES = [
    Case("none", "none", "odometry alone"),
    Case("none", "none", "graph"),
    Case("none", "true", "graph"),
    Case("none", "true and 30 false", "graph"),
    Case(RTK, "none", "graph"),
    Case(RTK, "true", "graph"),
    Case(RTK, "true and 30 false", "graph"),
    Case("single point", "none", "graph"),
    Case("single point", "true", "graph"),
    Case("none", "none", "odometry alone", 0.02),
    Case("none", "true", "graph", 0.02),
    Case(RTK, "true", "graph", 0.02),
    Case("single point", "true", "graph", 0.02),
]


@dataclass(frozen=True)
class Errors:
    """Of one drive; NaN where a number has no meaning."""

    rms_m: float
    in_outages_m: float
    end_m: float
    nees: float
    used: float
    refused: float
    seconds: float


def gnss_for(case: Case, drive: MadeDrive, seed: int) -> tuple[GnssTrack | None, NDArray[np.bool_]]:
    """The fixes, and which frames (N,) are in an outage."""
    outage = np.zeros(len(drive.T_place_cam), bool)
    if case.gnss == "none":
        return None, outage
    if case.gnss == "single point":
        return gnss_of(drive, FixType.SINGLE, seed), outage
    track, gone = with_outages(with_bursts(gnss_of(drive, FixType.FIXED, seed), BURSTS), OUTAGES_S)
    return track, np.repeat(gone, 2)[: len(outage)]


def closures_for(case: Case, drive: MadeDrive, seed: int) -> LoopClosures | None:
    """None where the case has none."""
    return None if case.closures == "none" else closures_of(drive, seed, false=30 if "false" in case.closures else 0)


def measured(case: Case, seed: int) -> Errors:
    """One drive of one case."""
    drive = city_drive(CITY_WAY, seed, case.scale_sigma)
    gnss, outage = gnss_for(case, drive, 100 + seed)
    log = dataclasses.replace(drive.log, gnss=gnss)
    begin = time.perf_counter()
    if case.system == "odometry alone":
        geo = GeoReference(None, start_at(drive.T_place_cam)[0] @ drive.odometry.trajectory.T_world_cam, np.zeros((0, 6, 6)))
    else:
        geo = georeference(log, drive.odometry, closures=closures_for(case, drive, 200 + seed))
    seconds = time.perf_counter() - begin
    truth = start_at(drive.T_place_cam) if geo.frame is None else drive.truth_in(geo.frame)
    error = geo.T_enu_cam[:, :3, 3] - truth[:, :3, 3]
    norm = np.linalg.norm(error, axis=1)
    loops = geo.report.get("loops", {"used": 0, "refused": []})
    return Errors(
        rms(norm[~outage]), rms(norm[outage]), float(norm[-1]), nees(geo, error), loops["used"],
        sum(group["closures"] for group in loops["refused"]), seconds,
    )  # fmt: skip


def rigid_bound_m(drive: MadeDrive, kind: FixType, every: int = 2) -> tuple[float, float]:
    """(rms m, level rms m) of the best linear unbiased estimate of place and attitude by fixes with the simulator's noise, where
    the drive's shape is known: the trace of H (H^T C^-1 H)^-1 H^T over the frames (Gauss-Markov)."""
    place = drive.T_place_cam[::every, :3, 3]
    t_s = 1e-9 * drive.odometry.trajectory.t_ns[::every]
    correlation = SLOW_SHARE * np.exp(-np.abs(t_s[:, None] - t_s) / SLOW_S) + (1.0 - SLOW_SHARE) * np.eye(len(t_s))
    by_pose = np.concatenate([-se3.hat(place - place.mean(axis=0)), np.tile(np.eye(3), (len(place), 1, 1))], axis=2)
    sigma = SIGMA_M[kind] * np.array([1.0, 1.0, UP_FACTOR])
    information = sum(by_pose[:, axis].T @ np.linalg.solve(correlation, by_pose[:, axis]) / sigma[axis] ** 2 for axis in range(3))
    variance = np.einsum("nij,jk,nik->ni", by_pose, np.linalg.inv(information), by_pose).mean(axis=0)
    return float(np.sqrt(variance.sum())), float(np.sqrt(variance[:2].sum()))


def rms(norm: FloatArray) -> float:
    """NaN of nothing."""
    return float(np.sqrt((norm**2).mean())) if len(norm) else float("nan")


def nees(geo: GeoReference, error: FloatArray) -> float:
    """Mean of the squared errors (N, 3) in their sigmas, by three; the first metres of a drive in its own frame have none."""
    if not len(geo.covariance):
        return float("nan")
    rows = slice(20, None)
    covariance = position_covariance(geo.T_enu_cam, geo.covariance)[rows]
    return float(np.einsum("ni,ni->n", error[rows], np.linalg.solve(covariance, error[rows, :, None])[:, :, 0]).mean() / 3.0)


def row(case: Case, runs: list[Errors], length_m: float) -> str:
    """Of the table."""

    def shown(name: str, digits: int = 3) -> str:
        values = np.array([getattr(run, name) for run in runs])
        return "" if np.isnan(values).any() else f"{np.median(values):.{digits}f} ({values.max():.{digits}f})"

    share = np.array([run.end_m for run in runs]) / length_m * 100.0
    counts = f"{np.median([run.used for run in runs]):.0f}, {np.median([run.refused for run in runs]):.0f}"
    cells = [
        case.gnss, f"{100 * case.scale_sigma:g} %", case.closures, case.system, shown("rms_m"), shown("in_outages_m"),
        shown("end_m"),
        f"{np.median(share):.3f} ({share.max():.3f})", shown("nees", 2), counts, shown("seconds", 1),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Measure all cases, print the table, write it where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    way = city_drive(CITY_WAY).T_place_cam[:, :3, 3]
    length_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    lines = []
    for case in CASES:
        lines.append(row(case, [measured(case, seed) for seed in range(options.seeds)], length_m))
        print(lines[-1], flush=True)
    if options.write:
        bound, level = rigid_bound_m(city_drive(CITY_WAY), FixType.SINGLE)
        head = HEAD.format(length=length_m / 1000.0, seeds=options.seeds, bound=bound, level=level)
        REPORT.write_text(head + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
