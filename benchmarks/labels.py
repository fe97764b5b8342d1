"""Tables of the label benchmark in docs/results.md: `python benchmarks/labels.py DATASET… [--source SOURCE…] [--write TABLE]`.

A DATASET is what `wayloom benchmark labels` takes; the drives of all are pooled. Every network of the catalogue whose file is
here is measured against every SOURCE of truth. --write puts the tables into docs/results.md between the marks of TABLE.
docs/results.md gives the commands that draw the datasets; only the files of foreign networks (WAYLOOM_MODELS) come from elsewhere.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from pages import put_between_marks
from real_clips import RESULTS
from real_labels import found_networks
from wayloom.config.classes import CLASS_ID
from wayloom.evaluation.label_gains import Gain, share_of_right_votes, some_vote_is_right
from wayloom.evaluation.label_scores import LabelScores, count, scores
from wayloom.evaluation.label_tables import PAPER_ROWS
from wayloom.evaluation.label_truth import LabelledDrive, find_labelled_drives
from wayloom.evaluation.labels import LabelBenchmark, LabelledPoints, benchmark_labels
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.segmentation.catalogue import MODELS

TITLES = {"baseline": "single image", "tcl_mono": "TCL mono", "tcl_stereo": "TCL stereo", "best": "default form"}
TRUTHS = {"auto": "", "kitti-360": "", "scanned": "through LiDAR", "drawn": "drawn truth"}
TABLES = ("label benchmark, LiDAR", "label benchmark, drawn")
VOTERS = {
    "of obs(p)": ("tcl_stereo", PAPER),
    "of the default form": ("best", LabellingSettings(votes="hard", spread=0.0, class_prior_power=0.0)),
}


@dataclass
class Bound:
    """Of all judged points, those at boundaries too.

    truth, labels  train ids
    by_paper       whether the paper's filter keeps the point: it is at no boundary
    possible       whether some image is right
    share          share of the votes that are right
    """

    truth: list[np.ndarray] = field(default_factory=list)
    by_paper: list[np.ndarray] = field(default_factory=list)
    labels: list[np.ndarray] = field(default_factory=list)
    possible: list[np.ndarray] = field(default_factory=list)
    share: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True)
class Measured:
    """One network against one source of truth."""

    title: str
    result: LabelBenchmark
    bounds: dict[str, Bound]


def main() -> None:
    """Measure every network, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--source", nargs="+", choices=list(TRUTHS), default=["auto"], help="of the truth: one table row for each")
    parser.add_argument("--work", type=Path, help="keep tracks and label images here")
    parser.add_argument("--models", nargs="+", default=list(MODELS), help="names of the catalogue, or TOML files")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--write", choices=TABLES, help="put the tables into docs/results.md")
    options = parser.parse_args()
    measured = []
    for network in found_networks(options.models):
        for source in options.source:
            bounds = {name: Bound() for name in VOTERS}
            result = benchmark_labels(
                drives_of(options.datasets, source),
                network,
                work_dir=options.work,
                threads=options.threads,
                show=partial(add_to_bounds, bounds),
            )
            title = result.model if len(options.source) == 1 else f"{result.model}, {TRUTHS[source] or source}"
            measured.append(Measured(title, result, bounds))
            print(gain_table(measured[-1:]), flush=True)
    text = tables(measured)
    print(text, end="")
    if options.write:
        put_between_marks(RESULTS, options.write, text)


def drives_of(datasets: Sequence[Path], source: str) -> list[LabelledDrive]:
    """Those of all data sets, named by their data set, too."""
    return [
        replace(drive, name=f"{dataset.name}-{drive.name}")
        for dataset in datasets
        for drive in find_labelled_drives(dataset, source)
    ]


def add_to_bounds(bounds: dict[str, Bound], done: LabelledPoints) -> None:
    """Add the judged points of a drive."""
    judged, truth = done.matches.judged_with_boundaries, done.matches.truth
    for name, (row, form) in VOTERS.items():
        votes, bound = label_points(done.odometry, done.images, form), bounds[name]
        bound.truth.append(truth[judged])
        bound.by_paper.append(done.matches.judged[judged])
        bound.labels.append(done.labels[row][judged])
        bound.possible.append(some_vote_is_right(votes, truth)[judged])
        bound.share.append(share_of_right_votes(votes, truth)[judged])


def tables(measured: list[Measured]) -> str:
    """Gains, levels, classes, the bound of any vote, and how many points each filter left out."""
    parts = [gain_table(measured), level_table(measured)]
    seen: set[str] = set()
    for one in measured:
        if one.result.model not in seen:
            parts += [class_table(one, "accuracy", "class-wise accuracy"), class_table(one, "iou", "IoU"), group_table(one)]
        seen.add(one.result.model)
    parts += [bound_table(measured), *filter_lines(measured)]
    return "\n".join(parts)


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def gain_table(measured: list[Measured]) -> str:
    """mIoU and OA gained over the single image: the paper's form first, then the default form."""
    (paper_miou, paper_oa), *paper = PAPER_ROWS.values()
    head = ["gained over the single image: mIoU [95 %] / OA, percent", "TCL stereo", "TCL mono", "default form"]
    gained = [f"{miou - paper_miou:+.1f} / {oa - paper_oa:+.1f}" for miou, oa in reversed(paper)]
    rows = [["the paper, KITTI-360", *gained, "–"]]
    for one in measured:
        for suffix, scores_of, gains in (
            ("", one.result.rows, one.result.gains),
            (", boundary points too", one.result.rows_with_boundaries, one.result.gains_with_boundaries),
        ):
            cells = [gain_cell(scores_of, gains, row) for row in ("tcl_stereo", "tcl_mono", "best")]
            rows.append([f"{one.title}{suffix}", *cells])
    return markdown(head, rows)


def gain_cell(rows: dict[str, LabelScores], gains: dict[str, Gain], row: str) -> str:
    """Gain of mIoU with its interval, and of OA."""
    gain = gains[row]
    return f"{gain.miou:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}] / {rows[row].oa - rows['baseline'].oa:+.1f}"


def level_table(measured: list[Measured]) -> str:
    """mIoU and OA of every row."""
    rows = [["the paper, KITTI-360", *(f"{miou} / {oa}" for miou, oa in PAPER_ROWS.values()), "–", "–"]]
    for one in measured:
        for suffix, of_kind in (("", one.result.rows), (", boundary points too", one.result.rows_with_boundaries)):
            cells = [f"{of_kind[row].miou:.1f} / {of_kind[row].oa:.1f}" for row in TITLES]
            rows.append([f"{one.title}{suffix}", *cells, str(of_kind["baseline"].points)])
    return markdown(["mIoU / OA, percent", *TITLES.values(), "points"], rows)


def class_table(one: Measured, measure: str, title: str) -> str:
    """IoU of each class, or its accuracy TP_c / N_c where N_c points got class c; by the paper's filter."""
    rows = one.result.rows
    names = [name for name in CLASS_ID if any(name in getattr(score, measure) for score in rows.values())]
    lines = []
    for row, label in TITLES.items():
        values = getattr(rows[row], measure)
        lines.append([label, *(f"{values[name]:.1f}" if name in values else "–" for name in names)])
    bound = next(iter(one.bounds.values()))
    truth = np.concatenate(bound.truth)[np.concatenate(bound.by_paper)]
    lines.append(["points of the class", *(str(int((truth == CLASS_ID[name]).sum())) for name in names)])
    return markdown([f"{one.title}, {title}", *names], lines)


def group_table(one: Measured) -> str:
    """Mean IoU of each group of classes; by the paper's filter."""
    rows = one.result.rows
    groups = list(rows["baseline"].groups)
    lines = [[title, *(f"{rows[row].groups[group]:.1f}" for group in groups)] for row, title in TITLES.items()]
    return markdown([f"{one.title}, mean IoU", *groups], lines)


def bound_table(measured: list[Measured]) -> str:
    """What a vote that always knew the right image would reach."""
    head = ["boundary points too", "the vote", "if it knew the right image", "no image right", "under half of the votes right"]
    return markdown(head, [bound_row(one.title, name, bound) for one in measured for name, bound in one.bounds.items()])


def bound_row(title: str, name: str, bound: Bound) -> list[str]:
    """The oracle's mIoU / OA, and of the points that the vote labels wrong, those without a right image or majority."""
    truth, labels = np.concatenate(bound.truth), np.concatenate(bound.labels)
    possible, share = np.concatenate(bound.possible), np.concatenate(bound.share)
    wrong = labels != truth
    reached = scores(count(truth, np.where(possible, truth, labels)))
    found = scores(count(truth, labels))
    never, less = 100 * (~possible[wrong]).mean(), 100 * (share[wrong] < 0.5).mean()
    levels = [f"{found.miou:.1f} / {found.oa:.1f}", f"{reached.miou:.1f} / {reached.oa:.1f}"]
    return [f"{title}, images {name}", *levels, f"{never:.0f} %", f"{less:.0f} %"]


def filter_lines(measured: list[Measured]) -> list[str]:
    """Points by filter, once for each source of truth; drives that were left out."""
    lines = []
    for one in measured:
        if one.result.model == measured[0].result.model:
            source = one.title.removeprefix(one.result.model).removeprefix(", ")
            numbers = ", ".join(f"{number} {name}" for name, number in one.result.filters.items())
            lines.append(f"Points{', ' + source if source else ''}: {numbers}.\n")
            lines += [f"Left out: {name}: {why}.\n" for name, why in one.result.losses.items()]
    return lines


if __name__ == "__main__":
    main()
