"""The geo-reference on made drives whose GNSS is wrong in every known way, and on a recording in street canyons.

    python benchmarks/georeference.py [--seeds 3] [--random 50] [--data FOLDER] [--only SECTION] [--write]

--seeds   drives of each case; --random drives with bursts, outages, clocks and lever arms by chance
--data    where the recordings lie; default is what WAYLOOM_DATA names, else ../shared/data
--only    cases, random, long or canyon; may come again
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

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.evaluation.gnss_cases import CaseResult, cases, judge, random_nees  # noqa: E402
from wayloom.evaluation.gnss_long_drives import LongResult, long_results  # noqa: E402
from wayloom.evaluation.wheel_drive import measure_wheel_drive  # noqa: E402

NUMBERS = ROOT / "benchmarks" / "georeference.json"
PAGE = DOCS / "benchmarks" / "georeference.md"


def case_table(results: list[CaseResult]) -> str:
    """Markdown: a row for each case."""
    lines = [
        "| case | error rms, worst drive, m | wrong fixes known, m | stated sigma, m | largest error / sigma | placed | message |",
        "| --- " * 7 + "|",
    ]
    for r in results:
        told = "" if np.isnan(r.told_m) else f"{r.told_m:.3f}"
        lines.append(
            f"| {r.name} | {r.rms_m:.3f}, {r.worst_rms_m:.3f} | {told} | {r.sigma_m:.3f} | {r.ratio:.1f} | {r.placed:.0%} "
            f"| {r.warned:.0%} |"
        )
    return "\n".join(lines) + "\n"


def long_table(results: list[LongResult]) -> str:
    """Markdown: a row for each part of a long drive."""
    lines = ["| drive of 5 km | error level, in height, m | stated sigma level, in height, m |", "| --- " * 3 + "|"]
    lines += [f"| {r.name} | {r.level_m:.3f}, {r.height_m:.3f} | {r.level_sigma_m:.3f}, {r.height_sigma_m:.3f} |" for r in results]
    return "\n".join(lines) + "\n"


def random_line(nees: list[float]) -> str:
    """What the random drives' NEES / 3 are, in words."""
    beyond = ", ".join(f"seed {k} {value:.1f}" for k, value in enumerate(nees) if value > 2.0) or "none"
    return (
        f"NEES / 3 over {len(nees)} random drives: mean {np.nanmean(nees):.2f}, median {np.nanmedian(nees):.2f}, a drive from "
        f"{np.nanmin(nees):.2f} to {np.nanmax(nees):.2f}; {int(np.isnan(nees).sum())} not placed. Beyond 2: {beyond}.\n"
    )


def measure_cases(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Table and numbers of the cases."""
    told: dict[bytes, float] = {}
    results = []
    for case in cases():
        results.append(judge(case, range(options.seeds), told=told))
        print(results[-1], flush=True)
    return case_table(results), {"seeds": options.seeds, "cases": [asdict(r) for r in results]}


def measure_random(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sentence and numbers of the random drives."""
    nees: list[float] = []
    for seed in range(options.random):
        nees += random_nees([seed]).tolist()
        print(f"random drive {seed}: {nees[-1]:.2f}", flush=True)
    return random_line(nees), {"nees": float(np.nanmean(nees)), "random": nees}


def measure_long(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Table and numbers of the long drives."""
    results = list(long_results())
    return long_table(results), {"long": [asdict(r) for r in results]}


def measure_canyon(options: argparse.Namespace) -> tuple[str, dict[str, object]]:
    """Sentence and numbers of the recording."""
    wheel = measure_wheel_drive(options.data / "smartloc")
    line = (
        f"smartLoc, Berlin, Potsdamer Platz, wheel odometry, horizontal: fixes {wheel.fixes_median_m:.1f} m off in the median, "
        f"the drive {wheel.median_m:.1f} m at a stated sigma of {wheel.sigma_m:.1f} m, never more than {wheel.ratio:.1f} sigmas.\n"
    )
    return line, {"wheel": asdict(wheel)}


SECTIONS = {"cases": measure_cases, "random": measure_random, "long": measure_long, "canyon": measure_canyon}


def main() -> None:
    """Measure, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
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
