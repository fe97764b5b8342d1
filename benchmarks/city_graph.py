"""The city graph on made fleets with exact truth; tables as docs/benchmarks/city_graph.md has them.

    python benchmarks/city_graph.py accuracy|cells|growth [--write]

accuracy  20 drives of four kinds over the same streets, ten seeds: places, NEES, false meetings, with and without the drives' own
          covariance of neighbours
cells     places by cells with their surroundings against the whole, by the width of the surroundings
growth    what one more drive costs, at 10 to 1,000 drives of one density
Times are those of one processor, kernels compiled before.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "core"))

import numpy as np  # noqa: E402

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.evaluation.city_graph import cells_against_whole, judged_kinds  # noqa: E402
from wayloom.evaluation.made_fleets import KINDS, made_fleet  # noqa: E402
from wayloom.stitching.city_graph import CityMemory, optimise_city  # noqa: E402
from wayloom.stitching.settings import CityGraphSettings  # noqa: E402

PAGE = DOCS / "benchmarks" / "city_graph.md"
SEEDS = range(10)
SIZES = (10, 100, 300, 1000)
HALOS = (250.0, 500.0, 750.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("accuracy", "cells", "growth"))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    compiles = made_fleet(5, 0)
    optimise_city(compiles.drives, compiles.meetings)
    rows = []
    for row in {"accuracy": accuracy, "cells": cells, "growth": growth}[options.what]():
        print(row, flush=True)
        rows.append(row)
    if options.write:
        put_between_marks(PAGE, options.what, "\n".join(rows))


def accuracy() -> Iterator[str]:
    """A row for each kind of drive."""
    head = "| GNSS | drives, placed | own place, rms m | after | where they meet RTK | worst there | NEES / 6 | by fleets |"
    for with_cross in (False, True):
        fleets = [made_fleet(20, 1000 + seed, with_cross=with_cross) for seed in SEEDS]
        cities = [optimise_city(fleet.drives, fleet.meetings) for fleet in fleets]
        kinds, count = judged_kinds(fleets, cities)
        what = "told by the drives" if with_cross else "derived"
        verdicts = (
            f"of {count.false} false meetings {count.false_used} used, of {count.right} right ones {count.right_refused} refused"
        )
        yield f"Covariance of neighbours {what}: {verdicts}.\n\n{head}\n" + "| --- " * 8 + "|"
        for kind in KINDS:
            k = kinds[kind]
            before = "–" if np.isnan(k.before_m) else f"{k.before_m:.2f}"
            places = f"{before} | {k.after_m:.3f} | {k.near_rtk_m:.3f} | {k.worst_near_rtk_m:.2f}"
            yield f"| {kind} | {k.drives}, {k.placed} | {places} | {np.mean(k.nees):.2f} | {min(k.nees):.2f} … {max(k.nees):.2f} |"
        yield ""


def cells() -> Iterator[str]:
    """A row for each width of the surroundings."""
    fleet = made_fleet(100, 2000)
    whole = optimise_city(fleet.drives, fleet.meetings, CityGraphSettings(whole_up_to=10**9))
    yield (
        "| surroundings m | cells | off the whole, cm: median | 95 % | most | in sigmas: 95 % | most | other verdicts |\n"
        + "| --- " * 8
        + "|"
    )
    for halo in HALOS:
        parts = optimise_city(fleet.drives, fleet.meetings, CityGraphSettings(whole_up_to=1, halo_m=halo))
        moved, sigmas, verdicts = cells_against_whole(whole, parts)
        cm = 100.0 * np.quantile(moved, [0.5, 0.95, 1.0])
        yield (
            f"| {halo:.0f} | {parts.windows} | {cm[0]:.3f} | {cm[1]:.2f} | {cm[2]:.1f} | {np.quantile(sigmas, 0.95):.3f} "
            f"| {sigmas.max():.2f} | {verdicts} |"
        )


def growth() -> Iterator[str]:
    """A row for each size: from nothing, then the last drive added."""
    yield (
        "| drives | submaps, meetings | cells | all s | one more drive: cells solved | s | of it bookkeeping s |\n"
        + "| --- " * 7
        + "|"
    )
    for count in SIZES:
        fleet, memory, settings = made_fleet(count, 3000), CityMemory(), CityGraphSettings(whole_up_to=1)
        last = fleet.drives[-2].drive_id
        drives = [drive for drive in fleet.drives if drive.drive_id != last]
        meetings = [one for one in fleet.meetings if last not in (one.drive_a, one.drive_b)]
        began = time.process_time()
        optimise_city(drives, meetings, settings, memory)
        all_s, began = time.process_time() - began, time.process_time()
        grown = optimise_city(fleet.drives, fleet.meetings, settings, memory)
        one_s, began = time.process_time() - began, time.process_time()
        optimise_city(fleet.drives, fleet.meetings, settings, memory)
        nothing_s = time.process_time() - began
        size = f"{sum(len(drive) for drive in fleet.drives)}, {len(fleet.meetings)}"
        yield f"| {count} | {size} | {grown.windows} | {all_s:.1f} | {grown.solved} | {one_s:.2f} | {nothing_s:.2f} |"


if __name__ == "__main__":
    main()
