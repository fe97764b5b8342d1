"""Draws docs/pictures/conventions.png, the frames of docs/conventions.md: `python docs/pictures/conventions.py`."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

Array = NDArray[np.float64]
COLOURS = ("#c0392b", "#1e8449", "#2471a3")
VIEW = np.array([[0.94, 0.34, 0.0], [-0.16, 0.44, 0.88]])  # oblique view: (2, 3), paper right and up of east, north, up
CAMERA_IN_ENU = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # columns: right, down, forward; looking north


def draw_frame(ax: Axes, origin: Array, axes: Array, names: tuple[str, str, str], title: str) -> None:
    """Three named arrows: origin (3,), one arrow a column of axes (3, 3), both in ENU."""
    start = VIEW @ origin
    for axis, name, colour in zip(axes.T, names, COLOURS, strict=True):
        end = VIEW @ (origin + axis)
        ax.annotate(
            "",
            end,
            start,
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.4, "shrinkA": 0, "shrinkB": 0},
            annotation_clip=False,
        )
        ax.text(*(start + 1.16 * (end - start)), name, color=colour, fontsize=11, ha="center", va="center")
    ax.text(start[0] - 0.1, start[1] - 0.5, title, fontsize=11, ha="right", color="#333333")


def draw_transform(ax: Axes, start: Array, end: Array, name: str) -> None:
    """A dashed line with the transform's name between two origins (3,) in ENU."""
    a, b = VIEW @ start, VIEW @ end
    ax.plot(*np.column_stack([a, b]), color="#888888", linestyle="--", linewidth=1.2, zorder=0)
    ax.text(*(0.5 * (a + b) + np.array([0.0, 0.12])), name, fontsize=11, color="#555555", ha="center")


def main() -> None:
    """Draw the picture beside this script."""
    figure, ax = plt.subplots(figsize=(9.0, 3.9), dpi=110)
    origin, first, later = np.zeros(3), np.array([2.6, 0.4, 0.9]), np.array([5.2, 1.6, 0.9])
    turn = np.radians(-30.0)
    yaw = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    draw_transform(ax, origin, first, r"$T_{enu\_world}$")
    draw_transform(ax, first, later, r"$T_{world\_cam}$")
    draw_frame(ax, origin, np.eye(3), ("east", "north", "up"), "enu")
    draw_frame(ax, first, CAMERA_IN_ENU, ("x right", "y down", "z forward"), "world: the first cam")
    draw_frame(ax, later, yaw @ CAMERA_IN_ENU, ("x", "y", "z"), "cam")
    ax.set_aspect("equal")
    ax.axis("off")
    ax.margins(0.06)
    figure.savefig(Path(__file__).with_suffix(".png"), bbox_inches="tight")


if __name__ == "__main__":
    main()
