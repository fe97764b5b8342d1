"""Makes the paper's table of docs/results.md: `python benchmarks/labels.py DATASET [--work DIR] [--write]`.

DATASET is what `wayloom benchmark labels` takes; every network of the catalogue whose file is here is measured. --write puts the
tables into docs/results.md between their marks.
"""

import argparse
from pathlib import Path

from real_clips import RESULTS
from real_labels import found_networks
from wayloom.evaluation.label_scores import LabelScores
from wayloom.evaluation.label_tables import PAPER_ROWS
from wayloom.evaluation.label_truth import find_labelled_drives
from wayloom.evaluation.labels import LabelBenchmark, benchmark_labels
from wayloom.segmentation.catalogue import MODELS

BEGIN, END = "<!-- label benchmark: begin -->\n", "<!-- label benchmark: end -->\n"
TITLES = {"baseline": "single image", "tcl_mono": "TCL mono", "tcl_stereo": "TCL stereo", "best": "default form"}


def main() -> None:
    """Measure every network, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--work", type=Path, help="keep tracks and label images here")
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="names of the catalogue, or TOML files")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/results.md")
    options = parser.parse_args()
    drives = find_labelled_drives(options.dataset)
    results = []
    for network in found_networks(options.models):
        results.append(benchmark_labels(drives, network, work_dir=options.work, threads=options.threads))
    text = table(results)
    print(text, end="")
    if options.write:
        before, rest = RESULTS.read_text().split(BEGIN)
        RESULTS.write_text(before + BEGIN + "\n" + text + "\n" + END + rest.split(END)[1])


def table(results: list[LabelBenchmark]) -> str:
    """The paper's rows beside ours, then the groups of classes."""
    lines = ["| mIoU / OA, percent | single image | TCL mono | TCL stereo | default form |", "| --- | --- | --- | --- | --- |"]
    paper = " | ".join(f"{miou} / {oa}" for miou, oa in PAPER_ROWS.values())
    lines.append(f"| the paper, KITTI-360 | {paper} | |")
    for result in results:
        for name, rows in (("", result.rows), (", boundary points too", result.rows_with_boundaries)):
            cells = " | ".join(f"{rows[row].miou:.1f} / {rows[row].oa:.1f}" for row in TITLES)
            lines.append(f"| {result.model}{name} | {cells} |")
    for result in results:
        lines += ["", *group_lines(result.model, result.rows_with_boundaries)]
    counts = results[0].filters
    lines += ["", "Points: " + ", ".join(f"{number} {name}" for name, number in counts.items()) + "."]
    return "\n".join(lines) + "\n"


def group_lines(model: str, rows: dict[str, LabelScores]) -> list[str]:
    """Mean IoU of each group of classes."""
    groups = list(rows["baseline"].groups)
    lines = [f"| {model}, boundary points too | {' | '.join(groups)} |", f"| --- {'| --- ' * len(groups)}|"]
    for row, title in TITLES.items():
        lines.append(f"| {title} | {' | '.join(f'{rows[row].groups[group]:.1f}' for group in groups)} |")
    return lines


if __name__ == "__main__":
    main()
