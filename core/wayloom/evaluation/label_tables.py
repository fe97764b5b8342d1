"""Tables of the label benchmark as text in the paper's layout, as CSV and as LaTeX."""

import csv
import io
from typing import Final

from wayloom.config.classes import CLASS_NAMES
from wayloom.evaluation.label_gains import PIECE_M, Gain
from wayloom.evaluation.label_scores import GROUPS, JUDGED, LabelScores
from wayloom.evaluation.labels import LabelBenchmark

TITLES: Final = {
    "baseline": "baseline (single image)", "tcl_mono": "TCL mono", "tcl_stereo": "TCL stereo", "best": "best (default)",
}  # fmt: skip
PAPER_ROWS: Final = {"baseline": (58.5, 91.4), "tcl_mono": (63.6, 94.1), "tcl_stereo": (65.1, 95.2)}
"""mIoU and OA that the paper gives for KITTI-360."""
_SHORT: Final = {"traffic light": "light", "traffic sign": "sign", "motorcycle": "motorc."}


def as_text(result: LabelBenchmark) -> str:
    """Both tables, without and with points at boundaries: IoU and accuracy of each class, gains; then the filters."""
    parts = [
        f"{len(result.drives)} drives ({', '.join(result.drives)}), network {result.model}",
        "",
        "Points away from label boundaries, as in the paper",
        _text_table(result.rows),
        _text_gains(result.gains),
        "",
        "With points at label boundaries",
        _text_table(result.rows_with_boundaries),
        _text_gains(result.gains_with_boundaries),
        "",
        "Points: " + ", ".join(f"{number} {name}" for name, number in result.filters.items()),
    ]
    parts += [f"left out: {name}: {why}" for name, why in result.losses.items()]
    return "\n".join(parts)


def as_csv(result: LabelBenchmark) -> str:
    """One line for each row, table and measure: classes, then the means."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [CLASS_NAMES[c] for c in JUDGED]
    writer.writerow(["points", "row", "measure", *names, *GROUPS, "mean", "overall accuracy", "count"])
    for kind, rows in (("without boundaries", result.rows), ("with boundaries", result.rows_with_boundaries)):
        for row, score in rows.items():
            iou = [_number(score.iou.get(name)) for name in names]
            accuracy = [_number(score.accuracy.get(name)) for name in names]
            groups = [_number(score.groups.get(name)) for name in GROUPS]
            writer.writerow([kind, row, "IoU", *iou, *groups, _number(score.miou), _number(score.oa), score.points])
            writer.writerow([kind, row, "accuracy", *accuracy, *[""] * len(GROUPS), "", _number(score.oa), score.points])
    return out.getvalue()


def as_latex(result: LabelBenchmark) -> str:
    """Four tabulars, classes as columns as in the paper: IoU and class-wise accuracy, without and with points at boundaries."""
    kinds = (("without boundaries", result.rows), ("with boundaries", result.rows_with_boundaries))
    parts = []
    for points, rows in kinds:
        comment = f"% points {points}; network {result.model};"
        iou = {row: (score.iou, [score.miou, score.oa]) for row, score in rows.items()}
        accuracy = {row: (score.accuracy, [score.oa]) for row, score in rows.items()}
        parts.append(_tabular(f"{comment} IoU in percent", ["mIoU", "OA"], iou))
        parts.append(_tabular(f"{comment} class-wise accuracy TP_c / N_c in percent, N_c points got class c", ["OA"], accuracy))
    return "\n\n".join(parts) + "\n"


def _tabular(comment: str, means: list[str], rows: dict[str, tuple[dict[str, float], list[float]]]) -> str:
    """One tabular: a column for each class, then the means. rows : name to values by class, and means."""
    names = [CLASS_NAMES[c] for c in JUDGED]
    heads = [*(rf"\rotatebox{{90}}{{{name}}}" for name in names), *means]
    lines = [comment, rf"\begin{{tabular}}{{l{'r' * len(heads)}}}", r"\hline", rf" & {' & '.join(heads)} \\", r"\hline"]
    for row, (by_class, of_all) in rows.items():
        cells = [*(_number(by_class.get(name)) or "--" for name in names), *map(_number, of_all)]
        lines.append(rf"{TITLES.get(row, row)} & {' & '.join(cells)} \\".replace("_", r"\_"))
    return "\n".join([*lines, r"\hline", r"\end{tabular}"])


def _text_table(rows: dict[str, LabelScores]) -> str:
    names = [CLASS_NAMES[c] for c in JUDGED if any(CLASS_NAMES[c] in score.iou for score in rows.values())]
    width = max(len(TITLES.get(row, row)) for row in rows)
    heads = [_SHORT.get(name, name)[:8] for name in names]
    lines = [" " * width + "  " + " ".join(f"{head:>8}" for head in [*heads, "mIoU", "OA"])]
    for row, score in rows.items():
        cells = [_number(score.iou.get(name)) or "-" for name in names]
        line = [*cells, _number(score.miou), _number(score.oa)]
        lines.append(f"{TITLES.get(row, row):{width}}  " + " ".join(f"{cell:>8}" for cell in line))
    lines.append("class-wise accuracy TP_c / N_c, N_c points got class c")
    for row, score in rows.items():
        cells = [_number(score.accuracy.get(name)) or "-" for name in names]
        lines.append(f"{TITLES.get(row, row):{width}}  " + " ".join(f"{cell:>8}" for cell in cells))
    groups = list(next(iter(rows.values())).groups)
    lines.append("groups, mean IoU: " + ", ".join(groups))
    for row, score in rows.items():
        cells = [_number(score.groups.get(name)) or "-" for name in groups]
        lines.append(f"{TITLES.get(row, row):{width}}  " + " ".join(f"{cell:>8}" for cell in cells))
    return "\n".join(lines)


def _text_gains(gains: dict[str, Gain]) -> str:
    said = [f"{TITLES.get(row, row)} {g.miou:+.1f} [{g.low:+.1f}, {g.high:+.1f}]" for row, g in gains.items()]
    return f"mIoU gained, and its 95 % interval (pieces of {PIECE_M:.0f} m resampled): " + "; ".join(said)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
