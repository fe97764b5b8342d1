"""Makes the realism table of docs/simulation.md: `python benchmarks/simulation.py [--write] [--json FILE]`.

Stereo pairs from random places of simulated cities beside the real clips and labelled frames of WAYLOOM_DATA (default
../shared/data), labelled by a real network that WAYLOOM_MODELS holds (`wayloom models convert`); what a pair costs beside the
prototype in WAYLOOM_PROTOTYPES (default ../shared/prototypes). --write puts the tables into docs/simulation.md, between its marks.
"""

import argparse
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

from pages import DOCS, put_between_marks
from wayloom.evaluation import simulated_views as simulated
from wayloom.evaluation.labelled_images import ImageScores, scores_on_camvid, scores_on_kitti
from wayloom.evaluation.realism import ImageStatistics, image_statistics
from wayloom.logs.registry import open_log
from wayloom.segmentation.catalogue import find_model
from wayloom.segmentation.network import Network
from wayloom.simulation.vehicle.rigs import sized_rig

ROOT = Path(__file__).resolve().parents[1]
PAGE = DOCS / "simulation.md"
EVERY_FRAME = 12
SEEDS = (7, 19, 31)
"""Of the cities that are measured; training cities begin at 1000."""
GOALS = {"accuracy": 85.0, "full": 1.1, "half": 0.35, "set_up": 20.0}


def real_statistics(folder: Path) -> ImageStatistics:
    """Every 12th pair of a clip."""
    log = open_log(folder)
    frames = [log.frame(k) for k in range(0, len(log), EVERY_FRAME)]
    return image_statistics([(frame.left, frame.right) for frame in frames], log.rig)


def statistics_table(a: ImageStatistics, b: ImageStatistics, ours: ImageStatistics) -> list[str]:
    """Both real clips beside the simulator, and how far it is from their mean."""
    high, excess = (a.high_slope + b.high_slope) / 2, 100 * (2 * ours.residual / (a.residual + b.residual) - 1)
    rows = [
        ("slope of the power spectrum", a.slope, b.slope, ours.slope, ""),
        ("above 0.15 cycles/px", a.high_slope, b.high_slope, ours.high_slope, f"{ours.high_slope - high:+.2f} (goal ±0.2)"),
        ("share of gradients over 7 grey levels", a.strong_gradients, b.strong_gradients, ours.strong_gradients, ""),
        ("share of candidate pixels matched", a.stereo_density, b.stereo_density, ours.stereo_density, ""),
        ("left against right, grey levels", a.residual, b.residual, ours.residual, f"{excess:+.0f} % (goal ±30 %)"),
    ]
    lines = ["| measure | clip A | clip B | simulated | against the mean of both |", "| --- | --- | --- | --- | --- |"]
    return lines + [f"| {name} | {x:.2f} | {y:.2f} | {z:.2f} | {against} |" for name, x, y, z, against in rows]


def number(value: float | None) -> str:
    """A percentage without decimals, a dash where there is none."""
    return "–" if value is None else f"{value:.0f}"


def class_table(rows: list[simulated.ClassRow], accuracies: tuple[float, float, float]) -> list[str]:
    """IoU of each class in percent, and the accuracies."""
    lines = ["| class | KITTI, 5 frames | CamVid, 39 frames | simulated | share of pixels |", "| --- | --- | --- | --- | --- |"]
    for row in rows:
        mark = " **(under 25)**" if row.falls_short else ""
        lines.append(
            f"| {row.name} | {number(row.kitti)} | {number(row.camvid)} | {number(row.simulated)}{mark} | {row.share:.1f} % |"
        )
    kitti, camvid, ours = accuracies
    return [*lines, f"| pixel accuracy | {kitti:.1f} | {camvid:.1f} | **{ours:.1f}** (goal 85) | |"]


def cost_table(costs: dict[str, simulated.Cost], prototype: float | None) -> list[str]:
    """CPU seconds."""
    theirs = "not measured" if prototype is None else f"{prototype:.2f}"
    return [
        "| CPU seconds | wayloom | prototype | goal |",
        "| --- | --- | --- | --- |",
        f"| a pair of full size, truth of both | {costs['full'].pair_s:.2f} | {theirs} (truth of one) | {GOALS['full']} |",
        f"| of half size | {costs['half'].pair_s:.2f} | | {GOALS['half']} |",
        f"| set-up of the demo city, full size, after the first run | {costs['full'].set_up_s:.1f} | | {GOALS['set_up']:.0f} |",
    ]


def main() -> None:
    """Measure, print, and where asked for write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("WAYLOOM_DATA", ROOT.parent / "shared" / "data")))
    parser.add_argument(
        "--prototypes", type=Path, default=Path(os.environ.get("WAYLOOM_PROTOTYPES", ROOT.parent / "shared" / "prototypes"))
    )
    parser.add_argument("--model", default="efficientvit-b0", help="a network that has never seen simulated images")
    parser.add_argument("--views", type=int, default=40, help="stereo pairs of each city")
    parser.add_argument("--json", type=Path, help="also write all numbers to this file")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/simulation.md")
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"no folder {options.data}: set WAYLOOM_DATA or give --data")
    clips = options.data / "kitti_odometry/sequences/00", options.data / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"
    network = Network(find_model(options.model))
    views = simulated.views_of_cities(SEEDS, options.views)
    simulated_pairs = [(view.left, view.right) for view in views]
    all_statistics = [*(real_statistics(clip) for clip in clips), image_statistics(simulated_pairs, sized_rig("full"))]
    counts = simulated.counts_of_views(network, views)
    photographs: list[ImageScores] = [
        scores_on_kitti(network, options.data / "labelled/kitti"),
        scores_on_camvid(network, options.data / "labelled/camvid"),
    ]
    rows = simulated.class_rows(counts, *photographs)
    accuracies = (photographs[0].accuracy, photographs[1].accuracy, simulated.accuracy(counts))
    costs = {size: simulated.cost_of(size, 10) for size in ("full", "half")}
    folder = options.prototypes / "city-simulator"
    prototype = simulated.cost_of_prototype(folder) if folder.is_dir() else None
    tables = statistics_table(*all_statistics), class_table(rows, accuracies), cost_table(costs, prototype)
    text = "\n\n".join("\n".join(table) for table in tables) + "\n"
    print(text, end="")
    if options.json:
        numbers = {
            "looks": [statistics.as_json() for statistics in all_statistics], "classes": [asdict(row) for row in rows],
            "accuracy": accuracies,
            "cost": {size: cost.as_json() for size, cost in costs.items()}, "prototype_pair_s": prototype,
        }  # fmt: skip
        options.json.write_text(json.dumps(numbers, indent=1) + "\n")
    if options.write:
        put_between_marks(PAGE, "realism", text)


if __name__ == "__main__":
    main()
