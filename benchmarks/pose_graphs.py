"""The pose graph solver on public graphs, with false loops, and by size; tables as docs/benchmarks/pose_graphs.md has them.

    python benchmarks/pose_graphs.py [FILE.g2o …] [--false-loops | --false-groups | --growth] [--seed 0] [--write]

FILE           default is every graph of pose_graphs/ in the folder that WAYLOOM_DATA names, else ../shared/data
--false-loops  with a tenth of false loops added, instead
--false-groups the same in groups of GROUP that agree with each other, instead
--growth       drives through a city of 1,000 to 100,000 poses, instead
--write        put the table into docs/benchmarks/pose_graphs.md (of all graphs only)
Times are those of one processor, kernels compiled before.
"""

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy loads its BLAS
    os.environ.setdefault(name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "core"))

from pages import DOCS, put_between_marks  # noqa: E402
from wayloom.evaluation.made_graphs import city_drive, with_false_loops  # noqa: E402
from wayloom.evaluation.pose_graphs import false_loops, growth, optima  # noqa: E402
from wayloom.mapping.pose_graph import optimise_pose_graph  # noqa: E402

PAGE = DOCS / "benchmarks" / "pose_graphs.md"
TABLES = ("optima", "false-loops", "false-groups", "growth")
GROUP = 6
"""Loops that agree, in the third table."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    for what in TABLES[1:]:
        parser.add_argument(f"--{what}", dest="what", action="store_const", const=what, default=TABLES[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    optimise_pose_graph(with_false_loops(city_drive(1000, 50, 0).graph, 5, 0))  # compiles
    folder = Path(os.environ.get("WAYLOOM_DATA", ROOT / "../shared/data")) / "pose_graphs"
    files = options.files or [file for file in sorted(folder.glob("*.g2o")) if "truth" not in file.stem]
    if options.write and options.files:
        parser.error("--write is of all graphs: leave the files out")
    rows = []
    for row in table(options.what, files, options.seed):
        print(row, flush=True)
        rows.append(row)
    if options.write:
        put_between_marks(PAGE, options.what, "\n".join(rows))


def table(what: str, files: list[Path], seed: int) -> Iterator[str]:
    """The rows of one of TABLES."""
    if what == "growth":
        return growth(seed)
    if what == "optima":
        return optima(files)
    return false_loops(files, seed, 1 if what == "false-loops" else GROUP)


if __name__ == "__main__":
    main()
