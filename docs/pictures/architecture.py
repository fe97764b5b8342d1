"""Draws docs/pictures/architecture.png, the diagram of docs/architecture.md: `python docs/pictures/architecture.py`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle

from wayloom.config.stages import MAP_STAGES, drive_stages

COLOURS: Final = {"process": "#d6e6f5", "stage": "#eef4fa", "table": "#fbe9c6", "files": "#dcefdc", "outside": "#f2f2f2"}
DATA, CONTROL = "#2b5d8a", "#b0482f"


@dataclass(frozen=True)
class Box:
    """A box by its centre and size, in units of the picture."""

    x: float
    y: float
    width: float
    height: float
    text: str
    kind: str


BOXES: Final = {
    "vehicle": Box(1.2, 5.6, 2.0, 0.9, "vehicle,\nwayloom upload", "outside"),
    "browser": Box(1.2, 2.2, 2.0, 0.9, "dashboard,\nmap clients", "outside"),
    "api": Box(4.3, 3.9, 1.7, 4.6, "API\n\nuploads\ndrives\ntiles\nevents", "process"),
    "broker": Box(7.5, 5.9, 2.5, 0.6, "broker: wakes, may forget", "process"),
    "jobs": Box(7.5, 4.9, 2.5, 0.6, "jobs (the truth)", "table"),
    "drives": Box(7.5, 4.0, 2.5, 0.6, "drives, drive_files, uploads", "table"),
    "submaps": Box(7.5, 3.1, 2.5, 0.6, "submaps: place, covariance", "table"),
    "versions": Box(7.5, 2.2, 2.5, 0.6, "maps, map_versions, tiles", "table"),
    "sweeper": Box(7.5, 7.0, 2.5, 0.7, "sweeper: expired leases,\nunsent messages", "process"),
    "folders": Box(7.5, 8.1, 8.1, 0.5, "data folder: drive logs, stages/STAGE/KEY", "files"),
    "blobs": Box(7.5, 0.9, 8.1, 0.5, "object store: submaps and tiles, named by their SHA-256", "files"),
}
WORKER: Final = Box(10.9, 3.9, 2.0, 4.6, "", "process")


def draw_box(ax: Axes, box: Box) -> None:
    """Processes have round corners, tables a bar on top."""
    corner = (box.x - 0.5 * box.width, box.y - 0.5 * box.height)
    style = "round,pad=0.02,rounding_size=0.14" if box.kind in ("process", "stage", "outside") else "square,pad=0.0"
    patch = FancyBboxPatch(corner, box.width, box.height, boxstyle=style, fc=COLOURS[box.kind], ec="#555555", lw=1.0)
    ax.add_patch(patch)
    if box.kind == "table":
        ax.add_patch(Rectangle((corner[0], corner[1] + box.height - 0.07), box.width, 0.07, fc="#c9972f", ec="none"))
    ax.text(box.x, box.y, box.text, ha="center", va="center", fontsize=7.7)


def draw_arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float], colour: str, text: str = "") -> None:
    """Data solid, control dashed."""
    style = "--" if colour == CONTROL else "-"
    ax.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=11, color=colour, lw=1.3, linestyle=style))
    if text:
        level = start[1] == end[1]
        x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
        place = {"ha": "center", "va": "bottom"} if level else {"ha": "left", "va": "center"}
        ax.text(x if level else x + 0.1, y + 0.05 if level else y, text, fontsize=7.4, color=colour, **place)


def draw_worker(ax: Axes) -> None:
    """The workers with the stages of the catalogue, those of the map apart."""
    draw_box(ax, WORKER)
    ax.text(WORKER.x, WORKER.y + 2.1, "workers:\none stage at a time", ha="center", va="center", fontsize=7.7)
    of_drive = drive_stages()
    for row, stage in enumerate([*of_drive, *(stage.name for stage in MAP_STAGES)]):
        gap = 0.15 if row >= len(of_drive) else 0.0
        y = WORKER.y + 1.6 - 0.5 * row - gap
        draw_box(ax, Box(WORKER.x, y, 1.5, 0.32, stage, "stage"))
        if row:
            draw_arrow(ax, (WORKER.x, y + 0.36 + (gap if row == len(of_drive) else 0.0)), (WORKER.x, y + 0.16), DATA)


def draw_legend(ax: Axes) -> None:
    """What colours and lines mean."""
    for row, (kind, text) in enumerate((("process", "process"), ("table", "table of the database"), ("files", "files"))):
        ax.add_patch(Rectangle((0.2, 8.15 - 0.4 * row), 0.3, 0.22, fc=COLOURS[kind], ec="#555555"))
        ax.text(0.65, 8.26 - 0.4 * row, text, fontsize=8, va="center")
    for row, (colour, text) in enumerate(((DATA, "data"), (CONTROL, "control"))):
        draw_arrow(ax, (0.15, 7.05 - 0.35 * row), (0.55, 7.05 - 0.35 * row), colour)
        ax.text(0.65, 7.05 - 0.35 * row, text, fontsize=8, va="center")


def main() -> None:
    """Draw the picture beside this script."""
    figure, ax = plt.subplots(figsize=(10.4, 7.0), dpi=110)
    for box in BOXES.values():
        draw_box(ax, box)
    draw_worker(ax)
    draw_legend(ax)
    draw_arrow(ax, (2.2, 5.6), (3.45, 5.6), DATA, "drive log (tus)")
    draw_arrow(ax, (3.45, 2.2), (2.2, 2.2), DATA, "tiles, GeoJSON,\nevents (SSE)")
    api, tables, workers = 5.15, (6.25, 8.75), 9.9
    draw_arrow(ax, (api, 4.75), (tables[0], 4.75), CONTROL, "retry")
    draw_arrow(ax, (api, 4.0), (tables[0], 4.0), DATA, "manifest")
    draw_arrow(ax, (tables[0], 2.2), (api, 2.2), DATA, "version, hash")
    draw_arrow(ax, (workers, 4.9), (tables[1], 4.9), CONTROL, "claim, commit")
    draw_arrow(ax, (workers, 3.1), (tables[1], 3.1), DATA, "places")
    draw_arrow(ax, (workers, 2.2), (tables[1], 2.2), DATA, "one flip")
    draw_arrow(ax, (tables[1], 5.9), (workers, 5.9), CONTROL, "look at job n")
    draw_arrow(ax, (7.2, 5.2), (7.2, 5.6), CONTROL, "after the commit")
    draw_arrow(ax, (7.2, 6.65), (7.2, 6.2), CONTROL, "send again")
    ax.plot((6.25, 5.9, 5.9), (7.0, 7.0, 5.1), color=CONTROL, linestyle="--", lw=1.3)
    draw_arrow(ax, (5.85, 5.1), (6.25, 5.1), CONTROL)
    ax.text(5.8, 6.0, "queue\nagain", fontsize=7.4, color=CONTROL, ha="right", va="center")
    draw_arrow(ax, (4.3, 6.2), (4.3, 7.85), DATA, "files")
    draw_arrow(ax, (10.6, 7.85), (10.6, 6.2), DATA, "")
    draw_arrow(ax, (11.1, 6.2), (11.1, 7.85), DATA, "stages")
    draw_arrow(ax, (10.9, 1.6), (10.9, 1.15), DATA)
    draw_arrow(ax, (4.3, 1.15), (4.3, 1.6), DATA, "tiles")
    ax.set(xlim=(0.0, 12.1), ylim=(0.5, 8.5))
    ax.set_aspect("equal")
    ax.axis("off")
    figure.savefig(Path(__file__).with_suffix(".png"), bbox_inches="tight")


if __name__ == "__main__":
    main()
