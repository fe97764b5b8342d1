"""Registration between drives: recall by overlap, precision, errors against their covariances, and cost.

python benchmarks/meetings.py drives OUT LOG [OUT LOG ...]    all pairs of simulated drives of one city (with truth), as `wayloom
                                                              process` left them in OUT
python benchmarks/meetings.py alone OUT LOG OUT LOG [...]     drives in pairs, each second one's GNSS taken away
python benchmarks/meetings.py apart OUT LOG OUT LOG [...]     drives of different cities in pairs, the one falsely put where the
                                                              other is
python benchmarks/meetings.py halves EVEN ODD                 clip A as two drives with half in common, the second's GNSS degraded
python benchmarks/meetings.py make-halves DIR                 makes these two logs below DIR, for `wayloom process`

Further: --write (the table, and of `halves` the picture, into docs/benchmarks/meetings.md), --name NAME of the drives in the table.
"""

import argparse
import json
import os
import sys
import time
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from clip_halves import make_half, truth_of
from meeting_directions import PairError, direction_table, error_of
from meeting_pictures import wall_picture
from pages import DOCS, put_between_marks
from wayloom.geometry import se3
from wayloom.logs.simulated_truth import open_truth
from wayloom.loops.priors import Closure
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.places.files import load_places
from wayloom.registration.verification import both_ways
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.meetings import found_meetings, start_search
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import Meeting
from wayloom.stitching.view_pairs import PairSearch
from wayloom.submaps.files import load_submaps

PAGE = DOCS / "benchmarks" / "meetings.md"
PICTURE = DOCS / "pictures" / "meetings.jpg"
SETTINGS = MeetingSettings()
FALSE_M, FALSE_DEG = 1.0, 3.0
FINE_M, FINE_DEG = 0.05, 0.2
CHI2_95 = 12.59
"""Chi-square of 6 degrees of freedom."""
OVERLAPS = (0.1, 0.2, 0.3, 1.01)


@dataclass(frozen=True)
class KnownDrive:
    """A placed drive and the true T_enu_cam (K, 4, 4) of its keyframes."""

    drive: PlacedDrive
    truth: np.ndarray


def main() -> None:
    """Measure, print, write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drives", "alone", "apart", "halves", "make-halves"))
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--name", default="")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.what == "make-halves":
        for half in ("even", "odd"):
            print(*make_half(data_folder(), options.paths[0], half))
        return
    errors: list[PairError] = []
    rows = halves(*options.paths, options.write) if options.what == "halves" else of_drives(options.what, options.paths, errors)
    if errors:
        print(direction_table(errors))
    if options.write and options.what == "drives":
        put_between_marks(PAGE, f"directions {options.name}", direction_table(errors))
    if options.write:
        mark = " ".join(filter(None, (options.what, options.name)))
        put_between_marks(PAGE, mark, table(rows))


def data_folder() -> Path:
    return Path(os.environ.get("WAYLOOM_DATA", "../shared/data"))


def of_drives(what: str, paths: list[Path], errors: list[PairError]) -> list[dict[str, Any]]:
    """A row for each pair of drives; the errors of their pairs of views are put to the others."""
    drives = [known_drive(out, log) for out, log in zip(paths[::2], paths[1::2], strict=True)]
    rows = []
    if what == "drives":
        pairs = list(combinations(drives, 2))
    elif what == "alone":
        pairs = [(one, replace(other, drive=unlocated(other.drive))) for one, other in zip(drives[::2], drives[1::2], strict=True)]
    else:
        pairs = [(one, laid_over(other, one)) for one, other in zip(drives[::2], drives[1::2], strict=True)]
    for one, other in pairs:
        rows.append(apart_row(one, other) if what == "apart" else pair_row(one, other, errors))
        print(json.dumps(rows[-1]), flush=True)
    return [total(rows)] if what == "apart" else [row for row in rows if row]


def total(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """One row for all pairs of drives that do not meet."""
    sums = {name: round(sum(row[name] for row in rows), 1) for name in rows[0] if name != "drives"}
    return {"pairs of drives": len(rows)} | sums


def known_drive(out: Path, log: Path) -> KnownDrive:
    frames = load_odometry(out / "stages" / "odometry" / "odometry.npz").keyframes.frame
    return KnownDrive(placed_drive(out, log.name), open_truth(log).T_enu_cam[frames])


def placed_drive(out: Path, drive_id: str) -> PlacedDrive:
    places = load_places(out / "stages" / "places" / "drive.places")
    return PlacedDrive(drive_id, places, tuple(load_submaps(out / "stages" / "submaps")))


def unlocated(drive: PlacedDrive) -> PlacedDrive:
    """The drive as it would be without GNSS."""
    return PlacedDrive(drive.drive_id, drive.places, tuple(replace(item, frame=None) for item in drive.submaps))


def laid_over(other: KnownDrive, one: KnownDrive) -> KnownDrive:
    """The other drive as if its start were the first one's, as sure of that as a metre."""
    T = one.drive.T_enu_cam[0] @ se3.inverse(other.drive.T_enu_cam[0])
    at = np.eye(4)
    at[:3, 3] = one.drive.T_enu_cam[0][:3, 3]
    Ad = se3.adjoint(at)
    covariance = Ad @ np.diag([1.0] * 3 + [np.deg2rad(1.0) ** 2] * 3) @ Ad.T
    frame = one.drive.submaps[0].frame
    submaps = tuple(
        replace(item, T_enu_submap=T @ item.T_enu_submap, covariance=covariance, frame=frame) for item in other.drive.submaps
    )
    return KnownDrive(PlacedDrive(f"{other.drive.drive_id}-elsewhere", other.drive.places, submaps), other.truth)


def pair_row(one: KnownDrive, other: KnownDrive, errors: list[PairError]) -> dict[str, Any]:
    """Recall by overlap, errors of pairs of views, put to the others, and of meetings, and cost of two drives."""
    a, b = sorted((one, other), key=lambda known: known.drive.drive_id)
    start = time.process_time()
    search = start_search(a.drive, b.drive, SETTINGS)
    found, pairs = found_meetings(search)
    seconds = time.process_time() - start
    hits = recall(search, a.truth, b.truth, [(p.first, p.second - len(a.drive.places)) for p in pairs])
    if not sum(hits[1::2]) and not found.meetings:
        return {}
    errors += [error_of(p, a.truth[p.first], b.truth[p.second - len(a.truth)]) for p in pairs]
    of_pairs = errors_of_pairs(pairs, a, b)
    of_meetings = np.array([meeting_error(m, a, b) for m in found.meetings])
    row: dict[str, Any] = {"drives": f"{a.drive.drive_id}, {b.drive.drive_id}"}
    for k, (low, high) in enumerate(pairwise(OVERLAPS)):
        row[f"found at {low:.0%} to {min(high, 1.0):.0%}"] = f"{hits[2 * k]} of {hits[2 * k + 1]}"
    row |= summary("pairs", of_pairs) | summary("meetings", of_meetings)
    return row | {"tried": search_size(search), "CPU s": round(seconds, 1)}


def search_size(search: PairSearch) -> int:
    return len(search.tried)


def errors_of_pairs(pairs: list[Closure], a: KnownDrive, b: KnownDrive) -> np.ndarray:
    """(N, 3) metres, degrees, chi-square."""
    rows = ((a.truth[p.first], b.truth[p.second - len(a.truth)]) for p in pairs)
    return np.array([pair_error(p.T_first_second, p.covariance, *truth) for p, truth in zip(pairs, rows, strict=True)])


def pair_error(T: np.ndarray, covariance: np.ndarray, T_enu_a: np.ndarray, T_enu_b: np.ndarray) -> tuple[float, float, float]:
    """Metres, degrees, and chi-square of a relative pose."""
    truth = se3.inverse(T_enu_a) @ T_enu_b
    xi = se3.log(truth @ se3.inverse(T))
    metres = float(np.linalg.norm(T[:3, 3] - truth[:3, 3]))
    return metres, float(np.rad2deg(np.linalg.norm(xi[3:]))), float(xi @ np.linalg.solve(covariance, xi))


def meeting_error(m: Meeting, a: KnownDrive, b: KnownDrive) -> tuple[float, float, float]:
    """Of the frames of two submaps."""
    anchors = []
    for known, submap in ((a, m.submap_a), (b, m.submap_b)):
        rows = np.flatnonzero(known.drive.submap_of == submap)
        anchors.append(known.truth[rows[np.argmin(np.linalg.norm(known.drive.T_submap_cam[rows, :3, 3], axis=1))]])
    return pair_error(m.T_a_b, m.covariance, *anchors)


def summary(name: str, errors: np.ndarray) -> dict[str, Any]:
    """Count, errors, and share within 95 %, of (N, 3) metres, degrees, chi-square."""
    if not len(errors):
        return {name: 0, f"{name}: false": 0, f"{name}: median, 95 %": "", f"{name}: fine": "", f"{name}: chi²/6, in band": ""}
    metres, degrees, chi2 = errors.T
    middle, high = (np.percentile(errors[:, :2], q, axis=0) for q in (50, 95))
    return {
        name: len(errors),
        f"{name}: false": int(((metres > FALSE_M) | (degrees > FALSE_DEG)).sum()),
        f"{name}: median, 95 %": f"{100 * middle[0]:.1f}, {100 * high[0]:.1f} cm; {middle[1]:.2f}, {high[1]:.2f}°",
        f"{name}: fine": f"{int(((metres <= FINE_M) & (degrees <= FINE_DEG)).sum())}",
        f"{name}: chi²/6, in band": f"{chi2.mean() / 6:.2f}, {(chi2 < CHI2_95).mean():.0%}",
    }


def recall(search: PairSearch, truth_a: np.ndarray, truth_b: np.ndarray, pairs: list[tuple[int, int]]) -> list[int]:
    """For each class of overlap: places of b, every 8 m, with a pair within 8 m of road, and all. The overlap is that of the view
    there and of the one of a whose middle is nearest, at the true pose."""
    a, b = search.a, search.b
    out = [0] * (2 * (len(OVERLAPS) - 1))
    for j in b.anchors(8.0).tolist():
        distance = np.linalg.norm(truth_a[a.middle[search.anchors], :3, 3] - truth_b[b.middle[j], :3, 3], axis=1)
        i = int(search.anchors[int(np.argmin(distance))])
        if distance.min() > 30.0:
            continue
        overlap = true_overlap(search, truth_a, truth_b, i, j)
        k = int(np.searchsorted(OVERLAPS, overlap, side="right")) - 1
        if 0 <= k < len(OVERLAPS) - 1:
            hit = any(abs(b.road[second] - b.road[b.middle[j]]) <= 8.0 for _, second in pairs)
            out[2 * k] += hit
            out[2 * k + 1] += 1
    return out


def true_overlap(search: PairSearch, truth_a: np.ndarray, truth_b: np.ndarray, i: int, j: int) -> float:
    """Of two views, laid over each other by the truth of the keyframes in their middles."""
    a, b, one, other = search.a, search.b, search.scene(0, i), search.scene(1, j)
    first, second = int(a.middle[i]), int(b.middle[j])
    T = a.between(i, first) @ se3.inverse(truth_a[first]) @ truth_b[second] @ b.between(second, j)
    return both_ways(one, other, one.view.T_level_cam @ T @ se3.inverse(other.view.T_level_cam))["overlap"]


def apart_row(one: KnownDrive, other: KnownDrive) -> dict[str, Any]:
    """Pairs of views tried, fitting, and meetings of two drives that never met: all would be false."""
    start = time.process_time()
    search = start_search(*sorted((one.drive, other.drive), key=lambda d: d.drive_id), SETTINGS)
    found, _ = found_meetings(search)
    report = found.report
    return {
        "drives": f"{one.drive.drive_id}, {other.drive.drive_id}",
        "views compared": report["tried"],
        "fit": report["fitting"],
        "taken": report["accepted"],
        "meetings": report["meetings"],
        "CPU s": round(time.process_time() - start, 1),
    }


def halves(even: Path, odd: Path, write: bool) -> list[dict[str, Any]]:
    """Clip A as two drives: where the second lies by its GNSS and by the meetings, seen from the first."""
    a, b = (KnownDrive(placed_drive(out, name), truth_of(data_folder(), name)) for out, name in ((even, "even"), (odd, "odd")))
    a, b = (
        replace(known, truth=known.truth[load_odometry(out / "stages" / "odometry" / "odometry.npz").keyframes.frame])
        for known, out in ((a, even), (b, odd))
    )
    rows = []
    for name, drive in (("single-point GNSS", b.drive), ("no GNSS", unlocated(b.drive))):
        start = time.process_time()
        search = start_search(a.drive, drive, SETTINGS)
        found, pairs = found_meetings(search)
        row = {"second half": name, "views compared": found.report["tried"], "fit": found.report["fitting"]}
        row |= summary("pairs", errors_of_pairs(pairs, a, b)) | {"meetings": len(found.meetings)}
        rows.append(row | {"CPU s": round(time.process_time() - start, 1)})
        print(json.dumps(rows[-1]), json.dumps(found.report), flush=True)
        if write and name == "single-point GNSS" and found.meetings:
            wall_picture(PICTURE, a.drive, b.drive, found.meetings)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as a Markdown table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


if __name__ == "__main__":
    main()
