"""Tables of the odometry benchmark as Markdown."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from wayloom.evaluation.odometry import DEFAULT, Summary
from wayloom.evaluation.odometry_peers import PROTOTYPE

Column = tuple[str, str, int]
"""Column title, name of the number, digits."""
CPU_SHARE = "share of the prototype's cpu"
INTRODUCTION = """# Odometry benchmark

Written whole by `python benchmarks/odometry.py --write` from the numbers in `benchmarks/odometry.json`; rows measured again
are replaced, the others stay. [The guide](../odometry.md) says what the odometry does, [the design](../odometry-design.md) why.

Each cell: median ± spread (largest minus smallest) over seeds of the choice of points. ATE is taken after the best rigid alignment,
no scale; t_rel and r_rel over stretches that fit the recording. Depths are compared with the simulator's truth images, on clip B
with LiDAR (the nearest return within 2 px that nothing hides from the camera, for points hosted up to three frames from the scan).
CPU times are of one thread, decoding included, with the learning of the drive's own lens, which is done once a drive; a dash where
they were taken on a busy machine. The prototype is run in turn with the product, seed by seed, and the share of its time is that of
the pairs. A block of 32×32 px has texture where ten of its pixels have a slope of 10 grey levels; it is covered where a point that
the keyframe hosts or really saw lies in it. Ablations are judged by the last truth of each recording.
"""
ACCURACY: tuple[Column, ...] = (
    ("ATE m", "ATE m", 3),
    ("t_rel %", "t_rel %", 2),
    ("r_rel °/100 m", "r_rel deg/100 m", 2),
    ("frame to frame mm", "frame mm", 1),
    ("length ratio", "length ratio", 4),
)
EFFORT: tuple[Column, ...] = (
    ("keyframes", "keyframes", 0),
    ("bias px", "bias px", 2),
    ("CPU ms a frame: mean", "cpu mean ms", 1),
    ("median", "cpu median ms", 1),
    ("p95", "cpu p95 ms", 1),
    ("of the prototype's mean", CPU_SHARE, 2),
    ("peak MB", "peak memory MB", 0),
    ("points a metre", "points/m", 0),
    ("textured blocks covered", "blocks covered", 2),
    ("on horizontal edges", "horizontal edges", 2),
)
ABLATED_DENSITY: tuple[Column, ...] = (("points a metre", "points/m", 0), ("blocks covered", "blocks covered", 2))
DEPTH: tuple[Column, ...] = (
    ("points compared", "depth points", 0),
    ("within 5 % up to 30 m", "depth within_5_percent", 3),
    ("more than 2 px off", "depth beyond_2_px", 3),
    ("road, facade, pole, vegetation within 10 cm up to 15 m", "depth surface_within_10_cm", 3),
    ("median error px, abs(x) < 0.3", "depth median_px_centre", 2),
    ("median error px, sides", "depth median_px_sides", 2),
)
DRIFT: tuple[Column, ...] = (
    ("km", "way km", 1),
    ("t_rel % over 100 m in the first km", "t_rel % first km", 3),
    ("in the last km", "t_rel % last km", 3),
    ("keyframes", "keyframes", 0),
    ("segments", "segments", 0),
    ("peak MB", "peak memory MB", 0),
)


def cell(summary: Summary, name: str, digits: int) -> str:
    """Median ± spread (largest minus smallest over the seeds); a dash where there is no number."""
    value = summary.median.get(name, np.nan)
    if not np.isfinite(value):
        return "–"
    spread = summary.spread[name]
    return f"{value:.{digits}f}" + (f" ± {spread:.{digits}f}" if summary.runs > 1 and round(spread, digits) > 0 else "")


def truths(summary: Summary) -> list[str]:
    """The names of the truths that a recording was compared with."""
    return [name[len("ATE m (") : -1] for name in summary.median if name.startswith("ATE m (")]


def row(cells: Iterable[str]) -> str:
    """One line of a table."""
    return "| " + " | ".join(cells) + " |"


def head(titles: Sequence[str]) -> list[str]:
    """The first two lines of a table."""
    return [row(titles), row(["---"] * len(titles))]


def accuracy_table(summaries: Sequence[Summary]) -> list[str]:
    """One row for each recording, truth and system."""
    lines = head(["recording", "truth", "system", "seeds", "tracked", *(title for title, _, _ in ACCURACY)])
    for summary in summaries:
        tracked = f"{summary.median['tracked']:.0f} of {summary.median['frames']:.0f}"
        for truth in truths(summary) or ["–"]:
            numbers = (cell(summary, f"{name} ({truth})", digits) for _, name, digits in ACCURACY)
            lines.append(row([summary.recording, truth, summary.variant, str(summary.runs), tracked, *numbers]))
    return lines


def plain_table(summaries: Sequence[Summary], columns: Sequence[Column]) -> list[str]:
    """One row for each summary, these columns."""
    lines = head(["recording", "system", *(title for title, _, _ in columns)])
    return lines + [row([s.recording, s.variant, *(cell(s, name, digits) for _, name, digits in columns)]) for s in summaries]


def parts_table(summaries: Sequence[Summary]) -> list[str]:
    """Wall ms a frame of each part, one row a recording: for the screen, because a busy machine spoils them."""
    parts = list(dict.fromkeys(name for s in summaries for name in s.median if name.startswith("part ")))
    lines = head(["recording", *(name.removeprefix("part ").removesuffix(" ms") for name in parts)])
    return lines + [row([s.recording, *(cell(s, name, 2) for name in parts)]) for s in summaries]


def ablation_table(summaries: Sequence[Summary], columns: Sequence[Column]) -> list[str]:
    """These numbers of each variant on each recording, of truths by the last one of each; lost frames are said."""
    recordings = list(dict.fromkeys(s.recording for s in summaries if s.variant != DEFAULT))
    titles = "; ".join(title for title, _, _ in columns)
    lines = head(["variant", *(f"{name}: {titles}" for name in recordings)])
    for variant in dict.fromkeys(s.variant for s in summaries):
        cells = {s.recording: _ablation_cell(s, columns) for s in summaries if s.variant == variant}
        lines.append(row([variant, *(cells.get(name, "–") for name in recordings)]))
    return lines


def _ablation_cell(summary: Summary, columns: Sequence[Column]) -> str:
    lost = summary.median["frames"] - summary.median["tracked"]
    last = f" ({truths(summary)[-1]})"
    names = ((name + last if name + last in summary.median else name, digits) for _, name, digits in columns)
    return "; ".join(cell(summary, name, digits) for name, digits in names) + (f", {lost:.0f} lost" if lost else "")


def with_share_of_prototype(summaries: Sequence[Summary]) -> list[Summary]:
    """The summaries, each of the product's with CPU_SHARE: its own, that of runs in turn, or its mean CPU time over the prototype's
    on the same recording."""
    other = {s.recording: s.median["cpu mean ms"] for s in summaries if s.variant.startswith(PROTOTYPE)}
    alone = [s for s in summaries if _is_own(s) and CPU_SHARE not in s.median and s.recording in other]
    shares = {s.recording: s.median["cpu mean ms"] / other[s.recording] for s in alone}
    return [
        replace(s, median={**s.median, CPU_SHARE: shares[s.recording]}, spread={**s.spread, CPU_SHARE: 0.0})
        if _is_own(s) and s.recording in shares
        else s
        for s in summaries
    ]


def _is_own(summary: Summary) -> bool:
    return summary.variant == DEFAULT


def page(summaries: Sequence[Summary]) -> str:
    """The whole page: accuracy, effort, depth, ablations; parts of it that were not measured are left out."""
    own = [s for s in summaries if _is_own(s)]
    systems = with_share_of_prototype([s for s in summaries if _is_own(s) or "cpu median ms" not in s.median])
    ablations = [s for s in summaries if "cpu median ms" in s.median]
    ablated = {s.recording for s in ablations if not _is_own(s)}
    ablations = [s for s in ablations if s.recording in ablated]
    seeds = sorted({s.runs for s in ablations if not _is_own(s)})
    deep = [s for s in ablations if "depth points" in s.median]
    blocks: list[tuple[bool, str, Callable[[], list[str]]]] = [
        (bool(systems), "Accuracy", lambda: accuracy_table(systems)),
        (bool(systems), "Effort and density", lambda: plain_table(systems, EFFORT)),
        (
            any("depth points" in s.median for s in own),
            "Depth",
            lambda: plain_table([s for s in own if "depth points" in s.median], DEPTH),
        ),
        (
            any("way km" in s.median for s in own),
            "Long drives",
            lambda: plain_table([s for s in own if "way km" in s.median], DRIFT),
        ),
        (bool(ablated), "Ablations: accuracy", lambda: [_seeds(seeds), "", *ablation_table(ablations, ACCURACY[:2])]),
        (bool(ablated), "Ablations: density", lambda: ablation_table(ablations, ABLATED_DENSITY)),
        (bool(ablated) and bool(deep), "Ablations: depth", lambda: ablation_table(deep, DEPTH[1:3])),
    ]
    text = [INTRODUCTION]
    for wanted, title, lines in blocks:
        if wanted:
            text += [f"## {title}", "", *lines(), ""]
    return "\n".join(text)


def _seeds(runs: Sequence[int]) -> str:
    return f"{' or '.join(map(str, runs))} seed{'' if list(runs) == [1] else 's'} each; the first row as in the tables above."
