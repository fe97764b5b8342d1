"""The geo-reference on made drives whose GNSS is wrong in every known way, and on a recording in street canyons.

    python benchmarks/georeference.py [--seeds 3] [--fresh 3] [--random 50] [--data FOLDER] [--only SECTION] [--write]

--seeds   drives of each case, from seed 0 on, and --fresh of them from seed FRESH on, by which nothing was chosen
--random  drives with bursts, outages, clocks and lever arms by chance, from seed UNSEEN on
--data    where the recordings lie; default is what WAYLOOM_DATA names, else ../shared/data
--only    cases, fresh, random, long, bound, receiver, canyon or bounds; may come again. `bound` is what single point fixes allow at
          best; `bounds`, all that is asked for beside what the other sections wrote, solves nothing
--write   the numbers into benchmarks/georeference.json, to which a test holds the geo-reference, and as tables into
          docs/benchmarks/georeference.md
"""

import argparse
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "core")]

import numpy as np  # noqa: E402

from georeference_bounds import bounds_table  # noqa: E402
from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.evaluation.gnss_cases import (  # noqa: E402
    BEYOND_SIGMAS,
    CaseResult,
    RandomResult,
    cases,
    judge,
    random_result,
    receiver_errors,
)
from wayloom.evaluation.gnss_long_drives import LongResult, bound_results, long_results  # noqa: E402
from wayloom.evaluation.wheel_drive import measure_wheel_drive  # noqa: E402

NUMBERS = ROOT / "benchmarks" / "georeference.json"
PAGE = DOCS / "benchmarks" / "georeference.md"
FRESH, UNSEEN = 100, 100


def case_table(results: list[CaseResult]) -> str:
    """Markdown: a row for each case."""
    lines = [
        "| case | error rms, worst drive, m | wrong fixes known, m | stated sigma, m | largest error / sigma | beyond 3 | placed "
        "| message |",
        "| --- " * 8 + "|",
    ]
    for r in results:
        told = "" if np.isnan(r.told_m) else f"{r.told_m:.3f}"
        lines.append(
            f"| {r.name} | {r.rms_m:.3f}, {r.worst_rms_m:.3f} | {told} | {r.sigma_m:.3f} | {r.ratio:.1f} | {r.beyond} "
            f"| {r.placed:.0%} | {r.warned:.0%} |"
        )
    return "\n".join(lines) + "\n"


def long_table(results: list[LongResult]) -> str:
    """Markdown: a row for each part of a long drive."""
    lines = ["| drive of 5 km | error level, in height, m | stated sigma level, in height, m |", "| --- " * 3 + "|"]
    lines += [f"| {r.name} | {r.level_m:.3f}, {r.height_m:.3f} | {r.level_sigma_m:.3f}, {r.height_sigma_m:.3f} |" for r in results]
    return "\n".join(lines) + "\n"


def random_line(results: list[RandomResult]) -> str:
    """What the random drives' NEES / 3 are, in words."""
    nees = np.array([r.nees for r in results])
    wide = ", ".join(f"seed {r.seed} {r.nees:.1f}" for r in results if r.nees > 2.0) or "none"
    beyond = ", ".join(f"seed {r.seed} {r.ratio:.1f}" for r in results if r.ratio > BEYOND_SIGMAS) or "none"
    return (
        f"NEES / 3 over {len(nees)} random drives, seeds {results[0].seed} to {results[-1].seed}: mean {np.nanmean(nees):.2f}, "
        f"median {np.nanmedian(nees):.2f}, a drive from {np.nanmin(nees):.2f} to {np.nanmax(nees):.2f}; "
        f"{int(np.isnan(nees).sum())} not placed. NEES / 3 beyond 2: {wide}. Any error beyond {BEYOND_SIGMAS:g} stated sigmas: "
        f"{beyond}.\n"
    )


def fresh_text(results: list[CaseResult]) -> str:
    """Which of the cases have drives beyond three stated sigmas, in words."""
    drives, beyond = sum(r.seeds for r in results), sum(r.beyond for r in results)
    first = (
        f"All {len(results)} cases from seed {FRESH} on, {results[0].seeds} drives of each: {beyond} of {drives} with an error "
        f"beyond {BEYOND_SIGMAS:g} stated sigmas.\n"
    )
    rows = [f"- {r.name}: {r.beyond} of {r.seeds}, at worst {r.ratio:.1f} sigmas\n" for r in results if r.beyond]
    return first + ("\n" + "".join(rows) if rows else "")


def measure_cases(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Table and numbers of the cases."""
    told: dict[bytes, float] = {}
    results = []
    for case in cases():
        results.append(judge(case, range(options.seeds), told=told))
        print(results[-1], flush=True)
    return case_table(results), {"seeds": options.seeds, "cases": [asdict(r) for r in results]}


def measure_fresh(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """List and numbers of the same cases on seeds that nobody looked at."""
    results = []
    for case in cases():
        results.append(judge(case, range(FRESH, FRESH + options.fresh)))
        print(results[-1], flush=True)
    return fresh_text(results), {"fresh": [asdict(r) for r in results]}


def measure_random(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sentence and numbers of the random drives."""
    results = []
    for seed in range(UNSEEN, UNSEEN + options.random):
        results.append(random_result(seed))
        print(results[-1], flush=True)
    return random_line(results), {"random": [asdict(r) for r in results]}


def measure_long(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Table and numbers of the long drives."""
    results = list(long_results())
    return long_table(results), {"long": [asdict(r) for r in results]}


def measure_bound(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Table and numbers of what single point fixes allow on five kilometres."""
    results = list(bound_results(range(options.seeds)))
    return long_table(results), {"bound": [asdict(r) for r in results]}


def measure_receiver(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sentence and numbers of clocks and lever arms."""
    found = receiver_errors(range(FRESH, FRESH + options.fresh))
    line = (
        f"City drives of a minute, RTK, seeds {FRESH} to {FRESH + options.fresh - 1}, at worst: clocks 50, 80 and 200 ms late to "
        f"{1e3 * found.clock_s:.1f} ms, a lever arm that is not given to {found.lever_level_m:.2f} m level and "
        f"{found.lever_height_m:.2f} m in height.\n"
    )
    return line, {"receiver": asdict(found)}


def measure_bounds(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """The table of all that is asked for, from what the other sections wrote."""
    return bounds_table(json.loads(NUMBERS.read_text(encoding="utf-8"))), {}


def measure_canyon(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sentence and numbers of the recording."""
    wheel = measure_wheel_drive(options.data / "smartloc")
    line = (
        f"smartLoc, Berlin, Potsdamer Platz, wheel odometry, horizontal: fixes {wheel.fixes_median_m:.1f} m off in the median, "
        f"the drive {wheel.median_m:.1f} m at a stated sigma of {wheel.sigma_m:.1f} m, never more than {wheel.ratio:.1f} sigmas.\n"
    )
    return line, {"wheel": asdict(wheel)}


SECTIONS = {
    "cases": measure_cases,
    "fresh": measure_fresh,
    "random": measure_random,
    "long": measure_long,
    "bound": measure_bound,
    "receiver": measure_receiver,
    "canyon": measure_canyon,
    "bounds": measure_bounds,
}


def main() -> None:
    """Measure, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--fresh", type=int, default=3)
    parser.add_argument("--random", type=int, default=50)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT / "../shared/data")))
    parser.add_argument("--only", choices=SECTIONS, action="append")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    for name in options.only or SECTIONS:
        text, numbers = SECTIONS[name](options)
        print(text)
        if options.write:
            known = json.loads(NUMBERS.read_text(encoding="utf-8"))
            NUMBERS.write_text(json.dumps({**known, **numbers}, indent=1) + "\n", encoding="utf-8")
            put_between_marks(PAGE, name, text)


if __name__ == "__main__":
    main()
