"""The odometry's benchmark as Markdown."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from wayloom.evaluation.odometry import DEFAULT, Summary

ACCURACY: tuple[tuple[str, str, int], ...] = (
    ("ATE m", "ATE m", 3),
    ("t_rel %", "t_rel %", 2),
    ("r_rel °/100 m", "r_rel deg/100 m", 2),
    ("frame to frame mm", "frame mm", 1),
    ("length ratio", "length ratio", 4),
)
"""Column title, name of the number, digits."""
EFFORT: tuple[tuple[str, str, int], ...] = (
    ("keyframes", "keyframes", 0),
    ("bias px", "bias px", 2),
    ("CPU ms a frame: mean", "cpu mean ms", 1),
    ("median", "cpu median ms", 1),
    ("p95", "cpu p95 ms", 1),
    ("peak MB", "peak memory MB", 0),
    ("points a metre", "points/m", 0),
    ("textured blocks covered", "blocks covered", 2),
    ("on horizontal edges", "horizontal edges", 2),
)
DEPTH: tuple[tuple[str, str, int], ...] = (
    ("points compared", "depth points", 0),
    ("within 5 % up to 30 m", "depth within_5_percent", 3),
    ("more than 2 px off", "depth beyond_2_px", 3),
    ("road, facade, pole, vegetation within 10 cm up to 15 m", "depth surface_within_10_cm", 3),
    ("median error px, abs(x) < 0.3", "depth median_px_centre", 2),
    ("median error px, sides", "depth median_px_sides", 2),
)


DRIFT: tuple[tuple[str, str, int], ...] = (
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
    lines = head(["recording", "truth", "system", "tracked", *(title for title, _, _ in ACCURACY)])
    for summary in summaries:
        tracked = f"{summary.median['tracked']:.0f} of {summary.median['frames']:.0f}"
        for truth in truths(summary) or ["–"]:
            numbers = (cell(summary, f"{name} ({truth})", digits) for _, name, digits in ACCURACY)
            lines.append(row([summary.recording, truth, summary.variant, tracked, *numbers]))
    return lines


def plain_table(summaries: Sequence[Summary], columns: Sequence[tuple[str, str, int]]) -> list[str]:
    """One row for each summary, these columns."""
    lines = head(["recording", "system", *(title for title, _, _ in columns)])
    return lines + [row([s.recording, s.variant, *(cell(s, name, digits) for _, name, digits in columns)]) for s in summaries]


def parts_table(summaries: Sequence[Summary]) -> list[str]:
    """Wall ms a frame of each part, one row a recording: for the screen, because a busy machine spoils them."""
    parts = list(dict.fromkeys(name for s in summaries for name in s.median if name.startswith("part ")))
    lines = head(["recording", *(name.removeprefix("part ").removesuffix(" ms") for name in parts)])
    return lines + [row([s.recording, *(cell(s, name, 2) for name in parts)]) for s in summaries]


def ablation_table(summaries: Sequence[Summary]) -> list[str]:
    """ATE and t_rel of each variant on each recording, by the last truth of each; lost frames are said."""
    recordings = list(dict.fromkeys(s.recording for s in summaries))
    lines = head(["variant", *(f"{name}: ATE m; t_rel %" for name in recordings)])
    for variant in dict.fromkeys(s.variant for s in summaries):
        cells = {s.recording: _ablation_cell(s) for s in summaries if s.variant == variant}
        lines.append(row([variant, *(cells.get(name, "–") for name in recordings)]))
    return lines


def _ablation_cell(summary: Summary) -> str:
    lost = summary.median["frames"] - summary.median["tracked"]
    truth = truths(summary)[-1]
    error = f"{cell(summary, f'ATE m ({truth})', 3)}; {cell(summary, f't_rel % ({truth})', 2)}"
    return error + (f", {lost:.0f} lost" if lost else "")


def page(summaries: Sequence[Summary], seeds: int) -> str:
    """The whole block: accuracy, effort, depth, ablations; parts of it that were not measured are left out."""
    own = [s for s in summaries if s.variant == DEFAULT]
    systems = [s for s in summaries if s.variant == DEFAULT or "cpu median ms" not in s.median]
    ablations = [s for s in summaries if "cpu median ms" in s.median]
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
        (
            len(ablations) > len(own),
            f"Ablations ({min((s.runs for s in ablations), default=0)} seeds)",
            lambda: ablation_table(ablations),
        ),
    ]
    text = [f"Median ± spread (largest minus smallest) over {seeds} seeds of the choice of points.", ""]
    for wanted, title, lines in blocks:
        if wanted:
            text += [f"**{title}**", "", *lines(), ""]
    return "\n".join(text)
