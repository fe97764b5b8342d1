"""Overview picture of a map: coverage and tracks of all drives, and insets of orthophoto and labelled points, with one legend."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE
from wayloom.exports.boxes import nothing_inside
from wayloom.exports.city_insets import Inset, chosen_insets, drawn_inset
from wayloom.exports.city_survey import Survey, surveyed
from wayloom.exports.source import MapSource
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.antimeridian import Box
from wayloom.tiles.preview import bar_length_m

FloatArray = NDArray[np.float64]
DPI: Final = 150
SIZE_IN: Final = (16.0, 9.4)
PAPER, INK, FAINT = "#fbfaf7", "#23262c", "#8a8f98"
COVERED, GRID = "#e3e1d8", "#efeee9"
TRACK_COLOURS: Final = ("#d62828", "#0077b6", "#e67e00", "#6a4c93", "#2a9d8f", "#b5179e")
NAMED_TRACKS: Final = 6
"""Where there are more drives they share one colour, and the legend says so."""
OVERVIEW_AT: Final = (0.02, 0.115, 0.53, 0.80)
INSETS_AT: Final = (0.57, 0.115, 0.41, 0.80)
GAP: Final = 0.012
ROWS: Final = ((), (1,), (1, 1), (1, 2), (2, 2))
"""Insets in each row, by how many there are."""
LETTERS: Final = "ABCD"
LETTER_IN: Final = 0.1
"""Radius of a letter's disc in the overview, inches."""
AROUND: Final = np.array([[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Where a letter may stand beside its frame: corners first."""
LEAST_SHARE: Final = 0.0005
"""Of the points that a class has in the legend."""


def write_city_picture(path: Path, source: MapSource, box: Box | None, provenance: Mapping[str, Any]) -> str:
    """Write the picture as PNG; what it shows, in words. Raises InputError where there is nothing to show, OSError."""
    survey = surveyed(source, box)
    if not survey.count:
        raise nothing_inside(path)
    figure = Figure(SIZE_IN, dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    overview = figure.add_axes(OVERVIEW_AT)
    places = _inset_places(len(insets := chosen_insets(survey)))
    window = _draw_overview(overview, survey)
    for letter, inset, at in zip(LETTERS, insets, places, strict=False):
        axes = figure.add_axes(at)
        _draw_inset(axes, source, survey, inset, letter)
    _mark_insets(overview, insets, window)
    _draw_legend(figure, survey)
    _draw_words(figure, survey, provenance)
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": "wayloom", "Comment": json.dumps(provenance)})
    write_atomically(path, data.getvalue())
    return f"{survey.count} points and {len(survey.tracks)} tracks, {len(insets)} inset{'' if len(insets) == 1 else 's'}"


def _inset_places(count: int) -> list[tuple[float, float, float, float]]:
    """Left, bottom, width, height of each inset in the figure: rows of two, but for one that is alone in its row."""
    left, bottom, width, height = INSETS_AT
    rows = ROWS[count]
    gap = GAP * SIZE_IN[0] / SIZE_IN[1]
    h, cells = (height - (len(rows) - 1) * gap) / max(len(rows), 1), []
    for number, columns in enumerate(rows):
        w, y = (width - (columns - 1) * GAP) / columns, bottom + (len(rows) - 1 - number) * (h + gap)
        cells += [(left + column * (w + GAP), y, w, h) for column in range(columns)]
    return cells


def _aspect(axes: Axes) -> float:
    """Width over height of the axes, as they are drawn."""
    _, _, width, height = axes.get_position().bounds
    return float(width * SIZE_IN[0] / (height * SIZE_IN[1]))


@dataclass(frozen=True, slots=True)
class Window:
    """Part of the map that axes show, m: middle (2,) and edges (2,)."""

    middle: FloatArray
    edges: FloatArray

    def show(self, axes: Axes) -> None:
        """Set the axes' limits."""
        low, high = self.middle - 0.5 * self.edges, self.middle + 0.5 * self.edges
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])


def _draw_overview(axes: Axes, survey: Survey) -> Window:
    """Coverage, classes from above, tracks; returns what is shown."""
    low, high = survey.low, survey.high
    edges = np.maximum(high - low, 20.0) * 1.12
    aspect = _aspect(axes)
    edges = np.array([max(edges[0], edges[1] * aspect), max(edges[1], edges[0] / aspect)])
    window = Window(0.5 * (low + high), edges)
    _frame_axes(axes, FAINT)
    window.show(axes)
    extent = (survey.corner[0], survey.corner[0] + survey.seen.shape[1] * survey.pixel_m,
              survey.corner[1], survey.corner[1] + survey.seen.shape[0] * survey.pixel_m)  # fmt: skip
    _draw_grid(axes, window)
    axes.imshow(survey.picture(COVERED), extent=extent, origin="lower", interpolation="nearest", aspect="auto", zorder=1)
    for number, track in enumerate(survey.tracks):
        colour = _track_colour(survey, number)
        axes.plot(
            *track.points[:, :2].T, color=colour, lw=2.0, zorder=3, solid_capstyle="round",
            path_effects=[withStroke(linewidth=3.6, foreground="white")],
        )  # fmt: skip
    window.show(axes)
    _draw_scale(axes, window)
    if survey.north_up:
        _draw_north(axes)
    return window


def _draw_grid(axes: Axes, window: Window) -> None:
    """Faint lines a round distance apart."""
    step = bar_length_m(0.25 * float(window.edges[0]))
    for axis, line in ((0, axes.axvline), (1, axes.axhline)):
        low, high = (window.middle[axis] + sign * window.edges[axis] / 2.0 for sign in (-1.0, 1.0))
        for at in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step:
            line(at, color=GRID, lw=0.8, zorder=0)


def _track_colour(survey: Survey, number: int) -> str:
    drives = sorted({track.drive_id for track in survey.tracks})
    if len(drives) > NAMED_TRACKS:
        return TRACK_COLOURS[0]
    return TRACK_COLOURS[drives.index(survey.tracks[number].drive_id)]


def _draw_inset(axes: Axes, source: MapSource, survey: Survey, inset: Inset, letter: str) -> None:
    aspect = _aspect(axes)
    edges = np.array([inset.edge_m * max(aspect, 1.0), inset.edge_m * max(1.0 / aspect, 1.0)])
    window = Window(inset.middle, edges)
    picture = drawn_inset(source, survey, window.middle, edges)
    low, high = window.middle - 0.5 * edges, window.middle + 0.5 * edges
    axes.imshow(picture, extent=(low[0], high[0], low[1], high[1]), origin="lower", interpolation="antialiased", aspect="auto")
    window.show(axes)
    _frame_axes(axes, INK)
    _draw_scale(axes, window, boxed=True)
    axes.text(
        0.025, 0.96, letter, transform=axes.transAxes, ha="left", va="top", fontsize=13, fontweight="bold", color="white",
        bbox={"boxstyle": "circle,pad=0.28", "facecolor": INK, "edgecolor": "white", "linewidth": 1.2}, zorder=6,
    )  # fmt: skip


def _mark_insets(overview: Axes, insets: list[Inset], window: Window) -> None:
    """Frames in the overview and their letters."""
    radius = LETTER_IN * float(window.edges[0]) / (OVERVIEW_AT[2] * SIZE_IN[0])
    taken: list[FloatArray] = []
    for letter, inset in zip(LETTERS, insets, strict=False):
        edge = max(inset.edge_m, 0.022 * float(window.edges[0]))
        corner = inset.middle - 0.5 * edge
        overview.add_patch(Rectangle((corner[0], corner[1]), edge, edge, fill=False, edgecolor=INK, lw=1.4, zorder=4))
        x, y = place = _place_of_letter(inset.middle, 0.5 * edge + 0.8 * radius, radius, window, taken)
        taken.append(place)
        overview.text(
            x, y, letter, ha="center", va="center_baseline", fontsize=10, fontweight="bold", color="white",
            bbox={"boxstyle": "circle,pad=0.22", "facecolor": INK, "edgecolor": "white"}, zorder=6,
        )  # fmt: skip


def _place_of_letter(middle: FloatArray, away: float, radius: float, window: Window, taken: list[FloatArray]) -> FloatArray:
    """Where a letter stands (2,): at the first place beside its frame, or farther off, moved into the window, that is free."""
    reach = 0.5 * window.edges - 1.2 * radius
    around = np.concatenate([(away + farther * radius) * AROUND for farther in (0.0, 2.0, 4.0)])
    places = np.clip(middle + around, window.middle - reach, window.middle + reach)
    apart = np.min([np.full(len(places), np.inf), *(np.linalg.norm(places - one, axis=1) for one in taken)], axis=0)
    return np.asarray(places[np.argmax(np.minimum(apart, 2.0 * radius))])


def _frame_axes(axes: Axes, colour: str) -> None:
    axes.set_facecolor("white")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(colour)
        spine.set_linewidth(1.0)


def _draw_scale(axes: Axes, window: Window, boxed: bool = False) -> None:
    """A bar of a round length at the bottom left, with its length above it."""
    width, height = window.edges
    length = bar_length_m(0.22 * float(width))
    low = window.middle - 0.5 * window.edges
    x, y = low[0] + 0.035 * width, low[1] + 0.04 * height
    halo = [withStroke(linewidth=3.4, foreground="white")]
    axes.plot([x, x + length], [y, y], color=INK, lw=2.6, solid_capstyle="butt", zorder=6, path_effects=halo)
    text = f"{length:g} m" if length < 1000 else f"{length / 1000:g} km"
    axes.text(
        x, y + 0.014 * height, text, ha="left", va="bottom", fontsize=9 if boxed else 10, color=INK, zorder=6, path_effects=halo
    )


def _draw_north(axes: Axes) -> None:
    axes.annotate(
        "N", xy=(0.96, 0.965), xytext=(0.96, 0.885), xycoords="axes fraction", textcoords="axes fraction", ha="center", va="center",
        fontsize=12, fontweight="bold", color=INK, zorder=6,
        arrowprops={"arrowstyle": "-|>,head_width=0.35,head_length=0.7", "color": INK, "lw": 1.6},
    )  # fmt: skip


def _draw_legend(figure: Figure, survey: Survey) -> None:
    """The classes that are there, the most frequent first, then the drives."""
    counts = survey.counts[: len(CLASS_NAMES)]
    shown = [label for label in np.argsort(-counts, kind="stable").tolist() if counts[label] > LEAST_SHARE * counts.sum()]
    handles: list[Any] = [
        Patch(facecolor=PALETTE[label] / 255.0, edgecolor=FAINT, lw=0.5, label=CLASS_NAMES[label]) for label in shown
    ]
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.012, 0.008), ncols=8, frameon=False, fontsize=10, labelcolor=INK,
        handlelength=1.2, handleheight=1.1, columnspacing=1.3,
    )  # fmt: skip
    lines = _track_lines(survey)
    figure.legend(
        handles=lines, loc="lower right", bbox_to_anchor=(0.988, 0.008), ncols=3 if len(lines) > 2 else 1, frameon=False,
        fontsize=10, labelcolor=INK, handlelength=1.6,
    )  # fmt: skip


def _track_lines(survey: Survey) -> list[Any]:
    drives = sorted({track.drive_id for track in survey.tracks})
    if len(drives) > NAMED_TRACKS:
        return [Line2D([], [], color=TRACK_COLOURS[0], lw=2.0, label=f"ways of {len(drives)} drives")]
    return [Line2D([], [], color=colour, lw=2.0, label=_short(name)) for name, colour in zip(drives, TRACK_COLOURS, strict=False)]


def _short(name: str) -> str:
    return name if len(name) <= 30 else f"{name[:12]}…"


def _draw_words(figure: Figure, survey: Survey, provenance: Mapping[str, Any]) -> None:
    drives = len({track.drive_id for track in survey.tracks})
    road_m = sum(float(np.linalg.norm(np.diff(track.points, axis=0), axis=1).sum()) for track in survey.tracks)
    road = f"{road_m:.0f} m" if road_m < 2000 else f"{road_m / 1000:.1f} km"
    title = f"{drives} {'drive' if drives == 1 else 'drives'}, {road} of road, {survey.count:,} voxels"
    figure.text(0.02, 0.955, title, fontsize=16, fontweight="bold", color=INK, ha="left", va="center")
    names = sorted(
        {one["network"]["name"] for one in provenance.get("drives", []) if "network" in one and "name" in one["network"]}
    )
    said = [survey.place_text, f"labels: {', '.join(names)}" if names else "", str(provenance.get("software", ""))]
    figure.text(0.98, 0.955, "   ·   ".join(filter(None, said)), fontsize=10, color=FAINT, ha="right", va="center")
