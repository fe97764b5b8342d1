"""Plots of a drive report as SVG text, deterministic for equal numbers."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.rigid import align_rigid
from wayloom.logs.types import FixType

FloatArray = NDArray[np.float64]
INK, MUTED, ACCENT, TRUTH, LOST, LOOP = "#1d2733", "#8a96a3", "#1264a3", "#2e8540", "#c0392b", "#8e44ad"
FIX_COLOURS: Final[Mapping[int, str]] = {
    FixType.NONE: "#b0b7bf",
    FixType.SINGLE: "#d9822b",
    FixType.FLOAT: "#e3b341",
    FixType.FIXED: "#57a773",
}
STYLE: Final[Any] = {
    "svg.hashsalt": "wayloom",
    "svg.fonttype": "none",
    "font.family": ["sans-serif"],
    "font.size": 9.5,
    "axes.edgecolor": "#c5ccd3",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
}


@dataclass(frozen=True, slots=True)
class TrackPicture:
    """Data of the trajectory plot, in a plane: across and along are (N, 2) m with the first mapped position at (0, 0).

    track     mapped camera positions
    tracked   (N,) bool
    segment   (N,) int
    fixes     (M, 2) GNSS fixes, fix_type (M,); None without GNSS
    truth     (N, 2) the log's truth, rigidly aligned to the track; None where it has none
    labels    what the two axes are
    loops     loop closures as in `pipeline.drive_quality`; None where there are none
    """

    track: FloatArray
    tracked: NDArray[np.bool_]
    segment: NDArray[np.int32]
    fixes: FloatArray | None
    fix_type: NDArray[np.uint8] | None
    truth: FloatArray | None
    labels: tuple[str, str]
    loops: Mapping[str, Any] | None = None


def aligned_truth(T_truth: FloatArray, T_estimate: FloatArray) -> FloatArray:
    """(N, 3) m: truth positions moved rigidly onto the estimate's (both (N, 4, 4)); NaN where truth is unknown."""
    known = np.isfinite(T_truth).all(axis=(1, 2))
    T = align_rigid(T_truth[known][:, :3, 3], T_estimate[known][:, :3, 3], np.ones(int(known.sum())))
    return np.asarray(se3.transform(T, T_truth[:, :3, 3]), dtype=np.float64)


def track_svg(picture: TrackPicture) -> str:
    """The trajectory seen from above, axes of one scale."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 5.2), layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        _draw_fixes(axes, picture)
        if picture.truth is not None:
            axes.plot(*picture.truth.T, color=TRUTH, linewidth=1.4, linestyle=(0, (4, 3)), label="truth, aligned", zorder=3)
        _draw_track(axes, picture)
        draw_loops(axes, picture.loops)
        axes.set_xlabel(f"{picture.labels[0]} (m)")
        axes.set_ylabel(f"{picture.labels[1]} (m)")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        axes.grid(color="#eef1f4", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="best", fontsize=8.5)
        return svg_text(figure, "Trajectory seen from above")


def _draw_fixes(axes: Axes, picture: TrackPicture) -> None:
    if picture.fixes is None or picture.fix_type is None:
        return
    for fix in FixType:
        chosen = picture.fix_type == fix
        if chosen.any():
            label = f"GNSS antenna, {fix.name.lower()} ({int(chosen.sum())})"
            axes.scatter(
                picture.fixes[chosen, 0],
                picture.fixes[chosen, 1],
                s=16,
                color=FIX_COLOURS[fix],
                alpha=0.75,
                linewidths=0,
                label=label,
                zorder=2,
            )


def _draw_track(axes: Axes, picture: TrackPicture) -> None:
    for i, segment in enumerate(np.unique(picture.segment)):
        here = picture.track[picture.segment == segment]
        axes.plot(*here.T, color=ACCENT, linewidth=2.0, label="mapped track" if i == 0 else None, zorder=4)
    lost = picture.track[~picture.tracked]
    if len(lost):
        axes.scatter(lost[:, 0], lost[:, 1], s=18, color=LOST, marker="x", label="lost frames", zorder=5)
    x, y = picture.track[:1].T
    axes.scatter(x, y, s=46, color="white", edgecolors=ACCENT, linewidths=1.8, zorder=6, label="start")


def draw_loops(axes: Axes, loops: Mapping[str, Any] | None) -> None:
    """A line for each closure, between the two places that were found to be one, with a dot at both."""
    if loops is None:
        return
    x1, y1, x2, y2 = np.array(loops["ends_m"])
    axes.plot([x1, x2], [y1, y2], "-", color=LOOP, linewidth=1.0, alpha=0.7, zorder=4)
    axes.plot(np.r_[x1, x2], np.r_[y1, y2], ".", color=LOOP, markersize=3, zorder=4, label=f"loop closures ({loops['count']})")


def svg_text(figure: Figure, title: str) -> str:
    """A figure as one <svg> element that scales with the page, titled for screen readers."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Title": title})
    text = stream.getvalue()
    return text[text.index("<svg") :]
