"""The pose graph solver on public graphs, with false loops, and by size; tables as docs/benchmarks/pose_graphs.md has them.

    python benchmarks/pose_graphs.py [FILE.g2o …] [--false-loops] [--growth] [--seed 0]

FILE           default is every graph of pose_graphs/ in the folder that WAYLOOM_DATA names, else ../shared/data
--false-loops  with a tenth of false loops added, instead
--growth       drives through a city of 1,000 to 100,000 poses, instead
Times are those of one processor, kernels compiled before.
"""

import argparse
import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "core"))

from wayloom.evaluation.made_graphs import city_drive, with_false_loops  # noqa: E402
from wayloom.evaluation.pose_graphs import false_loops, growth, optima  # noqa: E402
from wayloom.mapping.pose_graph import optimise_pose_graph  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--false-loops", action="store_true")
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    optimise_pose_graph(with_false_loops(city_drive(1000, 50, 0).graph, 5, 0))  # compiles
    folder = Path(os.environ.get("WAYLOOM_DATA", ROOT / "../shared/data")) / "pose_graphs"
    files = options.files or [file for file in sorted(folder.glob("*.g2o")) if "truth" not in file.stem]
    rows = growth(options.seed) if options.growth else false_loops(files, options.seed) if options.false_loops else optima(files)
    for row in rows:
        print(row, flush=True)


if __name__ == "__main__":
    main()
