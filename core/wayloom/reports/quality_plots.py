"""Plots of a drive's quality report (`pipeline.drive_quality`) as SVG text, deterministic for equal numbers."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wayloom.reports.plots import ACCENT, INK, LOST, MUTED, STYLE, draw_loops, svg_text

FloatArray = NDArray[np.float64]
Quality = Mapping[str, Any]
EAST, BURST = "#d9822b", "#f6d3cd"
AXES_ENU: Final = ("east", "north", "up")


def quality_pictures(quality: Quality) -> dict[str, str]:
    """Name to SVG of every picture that the drive's numbers allow. quality : content of quality.json."""
    return {name: draw(quality) for name, draw in PICTURES.items() if _has(quality, name)}


def _has(quality: Quality, name: str) -> bool:
    return quality["track"]["sigma"] is not None if name == "sigma" else quality[NEEDS[name]] is not None


def residuals_svg(quality: Quality) -> str:
    """Fix minus antenna over time, east, north and up, with the receiver's own one-sigma band; bursts are shaded."""
    figure = _figure(5.0)
    rows = figure.subplots(3, 1, sharex=True)
    fixes = quality["fixes"]
    t, used = np.array(fixes["t_s"]), np.array(fixes["used"], bool)
    residual, sigma = np.array(fixes["residual_enu_m"]), np.array(fixes["sigma_enu_m"])
    for axes, name, values, band in zip(rows, AXES_ENU, residual, sigma, strict=True):
        _draw_bursts(axes, quality["bursts"])
        axes.fill_between(t, -band, band, color="#dbe4ec", linewidth=0, label="σ that the receiver states")
        limit = _limit(values, band, used)
        axes.plot(t[used], values[used], ".", color=ACCENT, markersize=3.5, label="used")
        if (~used).any():
            axes.plot(t[~used], values[~used].clip(-limit, limit), "x", color=LOST, markersize=4, label="not used")
        axes.set_ylim(-1.05 * limit, 1.05 * limit)
        axes.set_ylabel(f"{name} (m)")
    rows[-1].set_xlabel("time (s)")
    handles, labels = rows[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(unique.values(), unique.keys(), loc="outside upper center", ncols=4, fontsize=8.5)
    return svg_text(figure, "Residuals of the GNSS fixes over time")


def _limit(values: FloatArray, sigma: FloatArray, used: NDArray[np.bool_]) -> float:
    """Half the height of an axis, m: bursts of 50 m must not flatten the rest, so what lies beyond is drawn at the edge."""
    inside = np.abs(values[used]).max(initial=0.0)
    typical = 4.0 * float(np.median(sigma)) if len(sigma) else 0.0
    return float(max(1.15 * inside, typical, 0.01))


def _draw_bursts(axes: Axes, bursts: list[dict[str, Any]]) -> None:
    for row, burst in enumerate(bursts):
        axes.axvspan(burst["from_s"], burst["to_s"], color=BURST, linewidth=0, label="burst" if row == 0 else None)


def drift_svg(quality: Quality) -> str:
    """The odometry alone, laid upon the result at the start, and the result's own sigma, along the road."""
    figure = _figure(2.4)
    axes = figure.subplots()
    drift, track = quality["drift"], quality["track"]
    axes.plot(drift["road_m"], drift["odometry_m"], color=EAST, linewidth=1.8, label="odometry alone, from the result")
    if track["sigma"] is not None:
        sigma = np.linalg.norm(np.array(track["sigma"]["enu_m"]), axis=0)
        axes.plot(track["road_m"], sigma, color=ACCENT, linewidth=1.8, label="result, σ of its position")
    axes.set_xlabel("road (m)")
    axes.set_ylabel("m")
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="best", fontsize=8.5)
    return svg_text(figure, "Drift of the odometry alone, and the sigma of the result")


def sigma_svg(quality: Quality) -> str:
    """One-sigma position, horizontal and up, and heading, along the road."""
    figure = _figure(3.4)
    above, below = figure.subplots(2, 1, sharex=True)
    track = quality["track"]
    east, north, up = np.array(track["sigma"]["enu_m"])
    above.plot(track["road_m"], np.hypot(east, north), color=ACCENT, linewidth=1.6, label="horizontal")
    above.plot(track["road_m"], up, color=MUTED, linewidth=1.6, label="up")
    below.plot(track["road_m"], track["sigma"]["heading_deg"], color=EAST, linewidth=1.6, label="heading")
    above.set_ylabel("σ (m)")
    below.set_ylabel("σ (°)")
    below.set_xlabel("road (m)")
    for axes in (above, below):
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="best", ncols=2, fontsize=8.5)
    return svg_text(figure, "Uncertainty of position and heading along the road")


def track_svg(quality: Quality) -> str:
    """The track from above, where its bursts were, and the places at which it closes upon itself."""
    figure = _figure(4.6)
    axes = figure.subplots()
    track = quality["track"]
    t, (x, y, _) = np.array(track["t_s"]), np.array(track["plane_m"])
    axes.plot(x, y, color=ACCENT, linewidth=1.8, zorder=3)
    for row, burst in enumerate(quality["bursts"]):
        here = (t >= burst["from_s"]) & (t <= burst["to_s"])
        axes.plot(x[here], y[here], color=LOST, linewidth=4.0, alpha=0.5, zorder=2, label="GNSS burst" if row == 0 else None)
    draw_loops(axes, quality["loops"])
    axes.plot(x[:1], y[:1], "o", color="white", markeredgecolor=ACCENT, markersize=7, zorder=5, label="start")
    east, north = ("east", "north") if quality["placed"] else ("right of the start", "ahead of the start")
    axes.set_xlabel(f"{east} (m)")
    axes.set_ylabel(f"{north} (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best", fontsize=8.5)
    return svg_text(figure, "The track from above")


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(7.4, height_in), layout="constrained")
    FigureCanvasSVG(figure)
    return figure


def _styled(draw: Callable[[Quality], str]) -> Callable[[Quality], str]:
    def styled(quality: Quality) -> str:
        with mpl.rc_context(STYLE | {"axes.grid": True, "grid.color": "#eef1f4", "axes.axisbelow": True, "text.color": INK}):
            return draw(quality)

    return styled


PICTURES: Final[Mapping[str, Callable[[Quality], str]]] = {
    "residuals": _styled(residuals_svg),
    "drift": _styled(drift_svg),
    "sigma": _styled(sigma_svg),
    "track": _styled(track_svg),
}
"""Name of each picture and what draws it."""
NEEDS: Final[Mapping[str, str]] = {"residuals": "fixes", "drift": "drift", "sigma": "track", "track": "track"}
"""The part of the quality report without which there is no such picture."""
