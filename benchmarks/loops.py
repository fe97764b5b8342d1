"""Loops and registration measured: simulated drives with truth, pairs of places of real drives, made pairs that do not overlap.

python benchmarks/loops.py drives OUT LOG [OUT LOG ...]   OUT of `wayloom process`, LOG simulated with --truth
python benchmarks/loops.py halves OUT OUT POSES           drives of even and odd frames of one log, its KITTI poses (frames by time)
python benchmarks/loops.py apart OUT OUT                  drives that never meet: every pair of anchors, no prior
python benchmarks/loops.py features OUT LOG [OUT LOG ...] anchors of all drives that lie apart: whether features suffice
python benchmarks/loops.py made [--pairs 1000]            made streets, other ones or look-alike blocks, no prior and false priors
python benchmarks/loops.py whole OUT LOG [OUT LOG ...]    what the graph makes of the closures: the drive's end against its start

Further: --json FILE, --write (the tables of `made` and `whole` into docs/benchmarks/loops.md; rows of drives that are not measured
now stay), --spacing METRES of the anchors of `halves`, `apart` and `features`.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pages import DOCS, between_marks, put_between_marks
from registration.made_streets import made_street, view_of
from wayloom.geometry import se3
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.logs.simulated_truth import open_truth
from wayloom.loops.files import LOOPS_FILE, load_loops
from wayloom.loops.search import find_loops
from wayloom.loops.types import LoopClosures
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.places.files import load_places
from wayloom.places.road import road_m, spaced
from wayloom.places.types import Places
from wayloom.places.views import view_at
from wayloom.registration.feature_evidence import feature_evidence
from wayloom.registration.matches import match, pose_of_matches
from wayloom.registration.register import Prior, register_scenes
from wayloom.registration.scene import prepare
from wayloom.registration.search import level_pose
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.verification import features_suffice

PAGE = DOCS / "benchmarks" / "loops.md"
SETTINGS = RegistrationSettings()
FALSE_M, FALSE_DEG = 1.0, 3.0
CHI2_95 = 12.59
"""Chi-square of 6 degrees of freedom."""
SAME_PLACE_M, ELSEWHERE_M = 6.0, 25.0
OPPOSITE = "other streets, opposite ways, a false prior of 3 m that both are one place"
SAME_WAY = "other streets, the same way, no local features, the same prior"
ALIKE = "look-alike blocks two blocks apart, an honest prior of 3 m"
WIDE = np.diag([3.0**2] * 2 + [0.5**2] + [np.deg2rad(1.0) ** 2] * 2 + [np.deg2rad(2.0) ** 2])


def main() -> None:
    """Measure, print, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drives", "halves", "apart", "features", "made", "whole"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--spacing", type=float, default=8.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if options.what == "drives":
        for out, log in zip(options.paths[::2], options.paths[1::2], strict=True):
            rows.append(drive_row(out, log))
            print(json.dumps(rows[-1]), flush=True)
    elif options.what == "halves":
        rows = halves(*options.paths, options.spacing)
    elif options.what == "apart":
        rows = [apart(*options.paths, options.spacing)]
    elif options.what == "features":
        rows = [features_alone(options.paths[::2], options.paths[1::2], options.spacing, options.pairs)]
    elif options.what == "whole":
        rows = [whole(out, log) for out, log in zip(options.paths[::2], options.paths[1::2], strict=True)]
    else:
        rows = made(options.pairs)
    if options.write and options.what in ("made", "whole"):
        put_between_marks(PAGE, options.what, table(rows) if options.what == "made" else with_other_drives(table(rows)))
    if options.what not in ("drives", "made"):
        print("\n".join(json.dumps(row) for row in rows))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


def places_of(out: Path) -> Places:
    return load_places(out / "stages" / "places" / "drive.places")


def drive_row(out: Path, log: Path) -> dict[str, Any]:
    """Precision, recall by direction, errors and time of one simulated drive."""
    places, odometry = places_of(out), load_odometry(out / "stages" / "odometry" / "odometry.npz")
    T_true = open_truth(log).T_enu_cam[odometry.keyframes.frame]
    start = time.process_time()
    loops = find_loops(places)
    seconds = time.process_time() - start
    metres, degrees, chi2 = errors(loops, T_true)
    false = (metres > FALSE_M) | (degrees > FALSE_DEG)
    row: dict[str, Any] = {
        "drive": f"{log.parent.name}/{log.name}",
        "road_m": round(float(road_m(places.T_world_keyframe)[-1])),
        "closures": len(loops),
        "false": int(false.sum()),
        **{name: f"{hit} of {count}" for name, (hit, count) in recall(loops, T_true, places).items()},
        "cpu_s": round(seconds, 1),
        "tried": loops.report["tried"],
    }
    if len(loops):
        row |= {"m_p50_p95": quantiles(metres), "deg_p50_p95": quantiles(degrees)}
        row |= {"nees_per_dof": round(float(chi2.mean()) / 6.0, 2), "within_95": round(float((chi2 < CHI2_95).mean()), 3)}
    return row


def errors(loops: LoopClosures, T_true: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(L,) metres, degrees, and chi-square of each closure against the truth of the keyframes (K, 4, 4)."""
    out = []
    for i, j, T, covariance in zip(loops.first, loops.second, loops.T_first_second, loops.covariance, strict=True):
        truth = se3.inverse(T_true[i]) @ T_true[j]
        out.append((*apart_by(T, truth), *chi2_of(T, truth, covariance)))
    columns = np.array(out).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def apart_by(T: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    turned = se3.log(T @ se3.inverse(truth))[3:]
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(np.rad2deg(np.linalg.norm(turned)))


def chi2_of(T: np.ndarray, truth: np.ndarray, covariance: np.ndarray) -> tuple[float]:
    xi = se3.log(truth @ se3.inverse(T))
    return (float(xi @ np.linalg.solve(covariance, xi)),)


def recall(loops: LoopClosures, T_true: np.ndarray, places: Places) -> dict[str, tuple[int, int]]:
    """Places every 4 m that are passed again, by direction: (with a closure within 4 m that goes the same way, all)."""
    road = road_m(places.T_world_keyframe)
    apart = np.linalg.norm(T_true[:, None, :3, 3] - T_true[None, :, :3, 3], axis=2)
    cosine = T_true[:, :3, 2] @ T_true[:, :3, 2].T
    again = (apart < SAME_PLACE_M) & (road[:, None] - road[None, :] >= 40.0)
    out = {}
    for name, along in (("same_way", cosine > 0.8), ("opposite", cosine < -0.8)):
        seconds = np.flatnonzero((again & along).any(axis=1))
        seconds = seconds[np.concatenate([[True], np.diff(road[seconds] // 4.0) > 0])] if len(seconds) else seconds
        good = along[loops.second, loops.first]
        hit = sum(bool((good & (np.abs(road[loops.second] - road[j]) < 4.1)).any()) for j in seconds)
        out[name] = (hit, len(seconds))
    return out


def whole(out: Path, log: Path) -> dict[str, Any]:
    """Closures of a processed drive, how many its graph uses, and its end against its start with them and by odometry alone."""
    odometry = load_odometry(out / "stages" / "odometry" / "odometry.npz")
    geo = load_georeference(out / "stages" / "georeference" / GEOREFERENCE_FILE)
    loops, T_true = load_loops(out / "stages" / "loops" / LOOPS_FILE), open_truth(log).T_enu_cam
    metres, degrees, _ = errors(loops, T_true[odometry.keyframes.frame])
    length = float(np.linalg.norm(np.diff(T_true[:, :3, 3], axis=0), axis=1).sum())
    with_graph, alone = (end_error(T, T_true) for T in (geo.T_enu_cam, odometry.trajectory.T_world_cam))
    return {
        "drive": f"{log.parent.name}/{log.name}",
        "GNSS": "none" if geo.frame is None else "as simulated",
        "road, m": round(length),
        "closures": len(loops),
        "false": int(((metres > FALSE_M) | (degrees > FALSE_DEG)).sum()),
        "used by the graph": geo.report.get("loops", {}).get("used", 0),
        "end, odometry alone": f"{alone:.2f} m, {alone / length:.3%}",
        "end, with the graph": f"{with_graph:.2f} m, {with_graph / length:.3%}",
    }


def end_error(T: np.ndarray, T_true: np.ndarray) -> float:
    """Metres by which the last camera is off, seen from the first."""
    return float(np.linalg.norm((se3.inverse(T[0]) @ T[-1] - se3.inverse(T_true[0]) @ T_true[-1])[:3, 3]))


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as a Markdown table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def with_other_drives(measured: str) -> str:
    """The table of `whole` as it stands on the page, with the measured rows, by drive and GNSS, in place of their former ones."""
    rows: dict[tuple[str, ...], str] = {}
    for line in between_marks(PAGE, "whole").splitlines() + measured.splitlines():
        rows[tuple(line.split(" | ")[:2])] = line
    return "\n".join(rows.values())


def halves(even: Path, odd: Path, poses: Path, spacing: float) -> list[dict[str, Any]]:
    """Pairs of anchors of two drives of one recording, each anchor of the one with the nearest of the other, no prior."""
    T_true = np.tile(np.eye(4), (len(numbers := np.loadtxt(poses)), 1, 1))
    T_true[:, :3] = numbers.reshape(-1, 3, 4)
    drives = [(places_of(out), load_odometry(out / "stages" / "odometry" / "odometry.npz")) for out in (even, odd)]
    truth = [T_true[frames_by_time(odometry.trajectory.t_ns)[odometry.keyframes.frame]] for _, odometry in drives]
    rows = []
    for i in anchors(drives[0][0], spacing):
        apart = np.linalg.norm(truth[1][:, :3, 3] - truth[0][i, :3, 3], axis=1)
        j = int(np.argmin(apart))
        a, b = prepare(view_at(drives[0][0], i), SETTINGS), prepare(view_at(drives[1][0], j), SETTINGS)
        found = register_scenes(a, b, None, SETTINGS)
        T = a.view.T_level_cam @ se3.inverse(truth[0][i]) @ truth[1][j] @ se3.inverse(b.view.T_level_cam)
        metres, degrees = apart_by(found.T_a_b, T)
        row = {
            "even": int(i),
            "odd": j,
            "apart_m": round(float(apart[j]), 2),
            "refused": found.refused,
            "overlap": found.evidence.get("overlap"),
        }
        rows.append(row | {"error_m": round(metres, 3), "error_deg": round(degrees, 3)})
    return rows


def frames_by_time(t_ns: np.ndarray) -> np.ndarray:
    """Frame numbers of stamps at KITTI's rate."""
    return np.rint(t_ns / 103.6e6).astype(np.int64)


def anchors(places: Places, spacing: float) -> np.ndarray:
    return np.flatnonzero(spaced(road_m(places.T_world_keyframe), places.segment, spacing))


def apart(one: Path, other: Path, spacing: float) -> dict[str, Any]:
    """Every pair of anchors of two drives that never meet, without a prior: how many are taken (all would be false)."""
    scenes = [[prepare(view_at(p, k), SETTINGS) for k in anchors(p, spacing)] for p in (places_of(one), places_of(other))]
    start, taken = time.process_time(), 0
    for a in scenes[0]:
        for b in scenes[1]:
            taken += not register_scenes(a, b, None, SETTINGS).refused
    pairs = len(scenes[0]) * len(scenes[1])
    return {
        "drives": [one.name, other.name],
        "pairs": pairs,
        "taken": taken,
        "cpu_s_a_pair": round((time.process_time() - start) / pairs, 2),
    }


def features_alone(outs: list[Path], logs: list[Path], spacing: float, pairs: int) -> dict[str, Any]:
    """Of pairs of anchors that lie apart, drawn evenly: in how many the features suffice for the pose that most agree with."""
    views, cameras = [], []
    for out, log in zip(outs, logs, strict=True):
        places, odometry = places_of(out), load_odometry(out / "stages" / "odometry" / "odometry.npz")
        for k in anchors(places, spacing):
            views.append(view_at(places, int(k)))
            cameras.append(open_truth(log).T_enu_cam[odometry.keyframes.frame[k], :3, 3])
    i, j = np.tril_indices(len(views), -1)
    apart_m = np.linalg.norm(np.array(cameras)[i] - np.array(cameras)[j], axis=1)
    chosen = np.random.default_rng(7).permutation(np.flatnonzero(apart_m > ELSEWHERE_M))[:pairs]
    found = []
    for x in chosen:
        matches = match(views[i[x]], views[j[x]])
        pose = pose_of_matches(*matches)
        if pose is not None and pose[1] >= SETTINGS.many_matches:
            found.append(feature_evidence(*matches, pose[0]))
    likest = min(found, key=lambda evidence: evidence["chance_log10"], default=None)
    suffice = sum(features_suffice(evidence, SETTINGS) for evidence in found)
    return {"pairs": len(chosen), "many agree": len(found), "suffice": suffice, "likest": likest}


def made(pairs: int) -> list[dict[str, Any]]:
    """Pairs of views of made streets that do not overlap: of different streets, without a prior and near a false one; and of
    look-alike blocks, two blocks apart, with an honest prior: by its covariance the alias, two blocks away, is no answer."""
    streets = max(4, round(pairs**0.5))
    views = [prepare(view_of(made_street(seed), 90.0, seed)[0], SETTINGS) for seed in range(streets)]
    opposite = [prepare(view_of(made_street(seed), 92.0, seed + 500, False)[0], SETTINGS) for seed in range(streets)]
    alike = [prepare(view_of(made_street(seed, 6, alike=True), 90.0, seed)[0], SETTINGS) for seed in range(streets)]
    other_block = [prepare(view_of(made_street(seed, 6, alike=True), 210.0, seed + 999)[0], SETTINGS) for seed in range(streets)]
    again = [prepare(view_of(made_street(seed), 92.0, seed + 500)[0], SETTINGS) for seed in range(streets)]
    made_seconds = {"other streets, no prior": again, OPPOSITE: opposite, SAME_WAY: again}
    rng, out = np.random.default_rng(0), []
    for name, share in (("other streets, no prior", 1), (OPPOSITE, 4), (SAME_WAY, 4), (ALIKE, 1)):
        count, words, start = max(1, pairs * share // 10), [], time.process_time()
        for n in range(count):
            i, step = n % streets, 1 + (n // streets) % (streets - 1)
            a, b = (alike[i], other_block[i]) if name == ALIKE else (views[i], made_seconds[name][(i + step) % streets])
            words.append(register_scenes(a, b, made_prior(name, rng), SETTINGS).refused)
        row = {"pairs": name, "count": count, "fit, but elsewhere too": sum("elsewhere" in text for text in words)}
        row |= {"taken": words.count(""), "CPU s a pair": round((time.process_time() - start) / count, 2)}
        print(json.dumps(row), flush=True)
        out.append(row)
    return out


def made_prior(name: str, rng: np.random.Generator) -> Prior | None:
    """What is believed of a made pair: falsely that both are one place; of look-alike blocks that two blocks lie between."""
    if name not in (OPPOSITE, SAME_WAY, ALIKE):
        return None
    T = level_pose(0.0, 0.0, 0.0, np.pi if name == OPPOSITE else 0.0)
    T[:2, 3] = rng.normal({OPPOSITE: [-3.6, 2.0], SAME_WAY: [0.0, 2.0], ALIKE: [0.0, 120.0]}[name], 3.0)
    return Prior(T, WIDE)


def quantiles(values: np.ndarray) -> list[float]:
    return [round(float(q), 3) for q in np.percentile(values, [50, 95])]


if __name__ == "__main__":
    main()
