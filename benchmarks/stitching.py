"""Points a second of the merge, and how much faster it is than the naive twin of the tests.

python benchmarks/stitching.py [--points 50000] [--submaps 20] [--json FILE]
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "stitching"))

from test_merge import naive

from submaps.made_submaps import random_submap
from wayloom.stitching.merge import merge


def main() -> None:
    """Measure, print one line, write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=50_000, help="of a submap")
    parser.add_argument("--submaps", type=int, default=20)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    merge([random_submap(0)])  # compiles
    placed = [random_submap(seed, options.points, spread_m=30.0) for seed in range(options.submaps)]
    few = [random_submap(seed, 500, spread_m=30.0) for seed in range(4)]
    rate = options.points * options.submaps / seconds(lambda: merge(placed))
    naive_rate = 2000 / seconds(lambda: naive(few, 0.1))
    result = {"points_per_second": rate, "naive_points_per_second": naive_rate, "ratio": rate / naive_rate}
    print(f"merge {rate:.3g} points/s, naive twin {naive_rate:.3g} points/s, ratio {result['ratio']:.0f}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def seconds(work: Callable[[], object]) -> float:
    """Wall time of the best of three runs."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    main()
