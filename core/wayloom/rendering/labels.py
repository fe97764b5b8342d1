"""Legend, scale bar and north arrow of a rendered view, as an overlay with transparency."""

from typing import Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from wayloom.rendering.cameras import Viewpoint
from wayloom.rendering.colouring import Legend
from wayloom.tiles.preview import bar_length_m

DPI: Final = 100.0
INK, CARD, HALO = "#20262e", "#ffffffd9", "#ffffff"
BAR_SHARE: Final = 0.14
SMALL_PX, LARGE_PX = 9.0, 15.0


def overlay(view: Viewpoint, legend: Legend, north_up: bool) -> NDArray[np.float32]:
    """(H, W, 4) RGBA, 0 to 1, to be laid over a picture of the view. Scale bar and north arrow are for orthographic views."""
    width, height = view.size_px
    figure = Figure((width / DPI, height / DPI), dpi=DPI, facecolor="none")
    canvas = FigureCanvasAgg(figure)
    text_px = float(np.clip(height / 62.0, SMALL_PX, LARGE_PX))
    points = text_px * 72.0 / DPI
    _draw_legend(figure, legend, points)
    if view.focal_px is None:
        _draw_scale(figure, view, points)
        if north_up:
            _draw_north(figure, view, points)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), np.float32) / np.float32(255.0)


def laid_over(picture: NDArray[np.uint8], over: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB: a picture under an overlay, whose colours are not multiplied by their opacity."""
    alpha = over[..., 3:]
    return np.asarray(np.rint(picture * (1.0 - alpha) + 255.0 * over[..., :3] * alpha), np.uint8)


def _draw_legend(figure: Figure, legend: Legend, points: float) -> None:
    handles: list[Any] = [
        Patch(facecolor=(colour[0] / 255.0, colour[1] / 255.0, colour[2] / 255.0), edgecolor="#00000033", lw=0.5, label=name)
        for name, colour in legend.entries.items()
    ]
    if legend.ramp is not None:
        name, low, high = legend.ramp
        steps = np.linspace(1.0, 0.0, 6)
        handles = [
            Line2D([], [], marker="s", ls="", ms=points, color=colormaps[name](step), label=f"{low + step * (high - low):.1f} m")
            for step in steps
        ]
    if not handles:
        return
    card = figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.012, 0.985), fontsize=points, labelcolor=INK, facecolor=CARD,
        edgecolor="none", framealpha=0.8, borderpad=0.8, handlelength=1.1, handleheight=1.0, labelspacing=0.45, fancybox=True,
    )  # fmt: skip
    card.get_frame().set_facecolor(CARD)


def _draw_scale(figure: Figure, view: Viewpoint, points: float) -> None:
    width, height = view.size_px
    length = bar_length_m(BAR_SHARE * width / view.metre_px)
    left, bottom = 0.02, 0.03 + 6.0 / height
    share = length * view.metre_px / width
    halo = [withStroke(linewidth=3.5, foreground=HALO)]
    line = Line2D([left, left + share], [bottom, bottom], color=INK, lw=2.6, solid_capstyle="butt", path_effects=halo)
    figure.add_artist(line)
    text = f"{length:g} m" if length < 1000 else f"{length / 1000:g} km"
    figure.text(left, bottom + 8.0 / height, text, color=INK, fontsize=points, va="bottom", path_effects=halo)


def _draw_north(figure: Figure, view: Viewpoint, points: float) -> None:
    width, height = view.size_px
    x, top = 1.0 - 34.0 / width, 1.0 - 22.0 / height
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor="none")
    axes.set_axis_off()
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    arrow = {"arrowstyle": "-|>,head_width=0.35,head_length=0.7", "color": INK, "lw": 1.6}
    axes.annotate(
        "N", xy=(x, top), xytext=(x, top - 62.0 / height), ha="center", va="center", color=INK, fontweight="bold",
        fontsize=1.15 * points, arrowprops=arrow, path_effects=[withStroke(linewidth=3.0, foreground=HALO)],
    )  # fmt: skip
