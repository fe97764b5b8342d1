"""Makes the paper's table of docs/results.md: `python benchmarks/labels.py DATASET… [--work DIR] [--write]`.

A DATASET is what `wayloom benchmark labels` takes; the drives of all are pooled; every network of the catalogue whose file is here
is measured. --write puts the tables into docs/results.md between their marks.
"""

import argparse
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from pages import put_between_marks
from real_clips import RESULTS
from real_labels import found_networks
from wayloom.config.classes import CLASS_ID
from wayloom.evaluation.label_gains import share_of_right_votes, some_vote_is_right
from wayloom.evaluation.label_scores import LabelScores, count, scores
from wayloom.evaluation.label_tables import PAPER_ROWS
from wayloom.evaluation.label_truth import find_labelled_drives
from wayloom.evaluation.labels import LabelBenchmark, LabelledPoints, benchmark_labels
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.segmentation.catalogue import MODELS

TITLES = {"baseline": "single image", "tcl_mono": "TCL mono", "tcl_stereo": "TCL stereo", "best": "default form"}


def main() -> None:
    """Measure every network, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, help="keep tracks and label images here")
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="names of the catalogue, or TOML files")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/results.md")
    options = parser.parse_args()
    drives = [replace(drive, name=f"{one.name}-{drive.name}") for one in options.datasets for drive in find_labelled_drives(one)]
    results = []
    for network in found_networks(options.models):
        bounds = {name: Bound() for name in VOTERS}
        result = benchmark_labels(drives, network, work_dir=options.work, threads=options.threads, show=partial(look, bounds))
        results.append((result, bounds))
        print(table(results[-1:]), flush=True)
    text = table(results)
    print(text, end="")
    if options.write:
        put_between_marks(RESULTS, "label benchmark", text)


@dataclass
class Bound:
    """Of all points, those at boundaries too: truth, some label, where some image is right, the truth's share of the votes."""

    truth: list[np.ndarray] = field(default_factory=list)
    labels: list[np.ndarray] = field(default_factory=list)
    possible: list[np.ndarray] = field(default_factory=list)
    share: list[np.ndarray] = field(default_factory=list)


VOTERS = {
    "of obs(p)": ("tcl_stereo", PAPER),
    "of the default form": ("best", LabellingSettings(votes="hard", spread=0.0, class_prior_power=0.0)),
}


def look(bounds: dict[str, Bound], done: LabelledPoints) -> None:
    """Note what the images of a drive say of its judged points."""
    judged, truth = done.matches.judged_with_boundaries, done.matches.truth
    for name, (row, form) in VOTERS.items():
        votes, bound = label_points(done.odometry, done.images, form), bounds[name]
        bound.truth.append(truth[judged])
        bound.labels.append(done.labels[row][judged])
        bound.possible.append(some_vote_is_right(votes, truth)[judged])
        bound.share.append(share_of_right_votes(votes, truth)[judged])


def bound_line(model: str, name: str, bound: Bound) -> str:
    """What a vote that always knew the right image would reach, and what the images say where the label is wrong."""
    truth, labels = np.concatenate(bound.truth), np.concatenate(bound.labels)
    possible, share = np.concatenate(bound.possible), np.concatenate(bound.share)
    wrong = labels != truth
    reached = scores(count(truth, np.where(possible, truth, labels)))
    found = scores(count(truth, labels))
    never, less = 100 * (~possible[wrong]).mean(), 100 * (share[wrong] < 0.5).mean()
    cells = f"{found.miou:.1f} / {found.oa:.1f} | {reached.miou:.1f} / {reached.oa:.1f} | {never:.0f} % | {less:.0f} %"
    return f"| {model}, images {name} | {cells} |"


def table(results: list[tuple[LabelBenchmark, dict[str, Bound]]]) -> str:
    """The paper's rows beside ours, then the gains, the groups of classes, and what bounds a vote."""
    lines = ["| mIoU / OA, percent | single image | TCL mono | TCL stereo | default form |", "| --- | --- | --- | --- | --- |"]
    paper = " | ".join(f"{miou} / {oa}" for miou, oa in PAPER_ROWS.values())
    lines.append(f"| the paper, KITTI-360 | {paper} | |")
    for result, _ in results:
        for name, rows in (("", result.rows), (", boundary points too", result.rows_with_boundaries)):
            cells = " | ".join(f"{rows[row].miou:.1f} / {rows[row].oa:.1f}" for row in TITLES)
            lines.append(f"| {result.model}{name} | {cells} |")
    heads = [TITLES[row] for row in TITLES if row != "baseline"]
    lines += ["", f"| mIoU gained [95 % of resamples] | {' | '.join(heads)} |", f"| --- {'| --- ' * len(heads)}|"]
    for result, _ in results:
        for name, gains in (("", result.gains), (", boundary points too", result.gains_with_boundaries)):
            shown = [f"{gains[row].miou:+.1f} [{gains[row].low:+.1f}, {gains[row].high:+.1f}]" for row in TITLES if row in gains]
            lines.append(f"| {result.model}{name} | {' | '.join(shown)} |")
    for result, bounds in results:
        truth = np.concatenate(bounds["of obs(p)"].truth)
        lines += ["", *class_lines(result.model, result.rows_with_boundaries, truth)]
        lines += ["", *group_lines(result.model, result.rows_with_boundaries)]
    lines += [
        "",
        "| boundary points too | the vote | if it knew the right image | no image right | under half of the votes right |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [bound_line(result.model, name, bound) for result, bounds in results for name, bound in bounds.items()]
    counts = results[0][0].filters
    lines += ["", "Points: " + ", ".join(f"{number} {name}" for name, number in counts.items()) + "."]
    lines += [f"Left out: {name}: {why}." for name, why in results[0][0].losses.items()]
    return "\n".join(lines) + "\n"


def class_lines(model: str, rows: dict[str, LabelScores], truth: np.ndarray) -> list[str]:
    """IoU of each class, and its points."""
    names = list(rows["baseline"].iou)
    points = [int((truth == CLASS_ID[name]).sum()) for name in names]
    lines = [f"| {model}, boundary points too | {' | '.join(names)} |", f"| --- {'| --- ' * len(names)}|"]
    for row, title in TITLES.items():
        lines.append(f"| {title} | {' | '.join(f'{rows[row].iou[name]:.1f}' for name in names)} |")
    return [*lines, f"| points | {' | '.join(map(str, points))} |"]


def group_lines(model: str, rows: dict[str, LabelScores]) -> list[str]:
    """Mean IoU of each group of classes."""
    groups = list(rows["baseline"].groups)
    lines = [f"| {model}, boundary points too | {' | '.join(groups)} |", f"| --- {'| --- ' * len(groups)}|"]
    for row, title in TITLES.items():
        lines.append(f"| {title} | {' | '.join(f'{rows[row].groups[group]:.1f}' for group in groups)} |")
    return lines


if __name__ == "__main__":
    main()
