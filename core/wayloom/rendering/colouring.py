"""Colours of a scene's points by class, height, grey value or drive, and what a legend says of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE, VOID
from wayloom.rendering.scene import SEVERAL, Scene

Colours = NDArray[np.uint8]
DRIVE_COLOURS: Final = ("#e4572e", "#17bebb", "#ffc914", "#8f5db7", "#76b041", "#d6499a", "#4a7fd4", "#c98b4e")
WAY: Final = (230, 57, 30)
SHARED: Final = (226, 228, 232)
UNLABELLED: Final = (120, 124, 130)
TEXTURE: Final = 0.45
"""How much of a point's brightness is the image's, where it is coloured by class."""
LEAST_SHARE: Final = 0.0005
HEIGHT_MAP: Final = "viridis"
HEIGHT_RANGE: Final = (0.01, 0.98)


@dataclass(frozen=True, slots=True)
class Legend:
    """entries: colours (RGB, 0 to 255) by the words beside them; ramp: a colour map's name, its lowest and highest value in m."""

    entries: Mapping[str, tuple[int, int, int]]
    ramp: tuple[str, float, float] | None = None


def by_class(scene: Scene) -> tuple[Colours, Legend]:
    """The classes' colours, with some of the images' texture."""
    counts = np.bincount(scene.label, minlength=256)
    table = np.full((256, 3), UNLABELLED, np.uint8)
    table[: len(PALETTE)] = PALETTE
    grey = scene.photo.mean(axis=1, keepdims=True) / 255.0
    level = np.median(grey) if len(grey) and grey.any() else 1.0
    texture = np.clip(1.0 + TEXTURE * (grey - level) / max(float(level), 0.2), 0.55, 1.35) if grey.any() else np.ones_like(grey)
    colours = np.clip(table[scene.label] * texture, 0, 255).astype(np.uint8)
    shown = [int(label) for label in np.argsort(-counts, kind="stable") if counts[label] > LEAST_SHARE * len(scene)]
    names = {label: "void" if label == VOID else CLASS_NAMES[label] for label in shown if label == VOID or label < len(CLASS_NAMES)}
    return colours, Legend({name: _rgb(table[label]) for label, name in names.items()})


def by_height(scene: Scene) -> tuple[Colours, Legend]:
    """Heights over the lowest, dark to bright."""
    low, high = np.quantile(scene.points[:, 2], HEIGHT_RANGE)
    share = np.clip((scene.points[:, 2] - low) / max(float(high - low), 0.5), 0.0, 1.0)
    colours = (255 * colormaps[HEIGHT_MAP](share)[:, :3]).astype(np.uint8)
    return colours, Legend({}, (HEIGHT_MAP, 0.0, float(max(high - low, 0.5))))


def by_photo(scene: Scene) -> tuple[Colours, Legend]:
    """As the cameras saw it."""
    return scene.photo, Legend({})


def way_colours(scene: Scene, colouring: str) -> Colours:
    """(K, 3) of the K ways: one for all, but for those of the drives where points are coloured by them."""
    if colouring != "drives":
        return np.tile(np.array(WAY, np.uint8), (len(scene.tracks), 1))
    return _drive_table()[np.arange(len(scene.tracks)) % len(DRIVE_COLOURS)]


def _drive_table() -> Colours:
    return np.array([[round(255 * part) for part in to_rgb(colour)] for colour in DRIVE_COLOURS], np.uint8)


def by_drive(scene: Scene) -> tuple[Colours, Legend]:
    """A colour a drive; pale where several drives agree, or where it is not known whose a point is."""
    table = _drive_table()
    colours = np.where((scene.drive == SEVERAL)[:, None], np.array(SHARED, np.uint8), table[scene.drive % len(table)])
    entries = {name: _rgb(table[row % len(table)]) for row, name in enumerate(scene.drives) if (scene.drive == row).any()}
    if len(scene.drives) > len(table):
        entries = {}
    if (scene.drive == SEVERAL).any():
        entries["several, or the ground"] = SHARED
    return colours, Legend(entries)


def _rgb(colour: Colours) -> tuple[int, int, int]:
    red, green, blue = colour.tolist()
    return red, green, blue


COLOURINGS: Final[Mapping[str, Callable[[Scene], tuple[Colours, Legend]]]] = {
    "class": by_class,
    "height": by_height,
    "grey": by_photo,
    "drives": by_drive,
}
