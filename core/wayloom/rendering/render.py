"""One rendered view into a file: which views there are, and what each is written as."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np

from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError, UnknownFormatError
from wayloom.files.atomic import write_atomically
from wayloom.rendering.cameras import Viewpoint, flight, from_above, oblique
from wayloom.rendering.colouring import COLOURINGS, Colours, Legend, way_colours
from wayloom.rendering.films import FRAMES_A_S, check_film, write_film
from wayloom.rendering.labels import laid_over, overlay
from wayloom.rendering.pictures import Picture, rendered, with_tracks
from wayloom.rendering.scene import Scene

View = Literal["top", "oblique", "fly"]
PICTURES: Final = (".png", ".jpg", ".webp")
PACE_M_S: Final = 9.0
LEAST_S, MOST_S = 3.0, 40.0


@dataclass(frozen=True, slots=True)
class Look:
    """How a scene is shown.

    colour : of COLOURINGS; tracks: whether the drives' ways are drawn; legend: whether there are words
    width_px, height_px : of oblique views and flights; the longer edge of a view from above is width_px
    azimuth_deg : to which an oblique view looks; None: across the scene
    seconds : of a flight; None: at 9 m/s, 3 to 40 s
    """

    view: View = "oblique"
    colour: str = "class"
    width_px: int = 1920
    height_px: int = 1080
    azimuth_deg: float | None = None
    seconds: float | None = None
    tracks: bool = True
    legend: bool = True


def check_look(look: Look, out: Path) -> None:
    """Raises UnknownFormatError or InputError where the file's name or the colour is not known, before anything is read."""
    if look.colour not in COLOURINGS:
        raise InputError(f"{look.colour} is no colouring", record="--colour", remedy=f"known are {', '.join(COLOURINGS)}")
    if look.view == "fly":
        check_film(out)
    elif out.suffix not in PICTURES:
        raise UnknownFormatError(f"{out.suffix or 'a folder'} is no picture", file=out, remedy="give a .png, .jpg or .webp")


def render(scene: Scene, look: Look, out: Path, progress: Progress = silent) -> str:
    """Write a view of a scene; what was written, in words. Raises InputError, UnknownFormatError, OSError."""
    check_look(look, out)
    if look.view == "fly":
        count = write_film(out, _flown(scene, look, progress))
        return f"{count} frames of {len(scene)} points"
    picture = shown(scene, look)
    written, data = cv2.imencode(out.suffix, np.ascontiguousarray(picture[:, :, ::-1]))
    assert written
    write_atomically(out, data.tobytes())
    return f"{picture.shape[1]} x {picture.shape[0]} pixels of {len(scene)} points"


def shown(scene: Scene, look: Look) -> Picture:
    """(H, W, 3) RGB of a scene from above or from one side."""
    size_px = (look.width_px, look.height_px)
    drawn, colours, legend = _coloured(scene, look)
    ways = scene.tracks if look.tracks else ()
    above = look.view == "top"
    view = from_above(drawn.points, look.width_px) if above else oblique(drawn.points, size_px, look.azimuth_deg, ways)
    picture = rendered(drawn, colours, view)
    return laid_over(picture, overlay(view, legend, scene.north_up)) if look.legend else picture


def _coloured(scene: Scene, look: Look) -> tuple[Scene, Colours, Legend]:
    colours, legend = COLOURINGS[look.colour](scene)
    if look.tracks:
        scene, colours = with_tracks(scene, colours, way_colours(scene, look.colour))
    return scene, colours, legend


def _flown(scene: Scene, look: Look, progress: Progress) -> Iterator[Picture]:
    """The frames of a flight along the longest way. Raises InputError where there is none."""
    if not scene.tracks:
        raise InputError("there is no way to fly along", remedy="give the folder of a drive, or --view oblique")
    way = max(scene.tracks, key=lambda one: float(np.linalg.norm(np.diff(one, axis=0), axis=1).sum()))
    length_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    seconds = look.seconds or float(np.clip(length_m / PACE_M_S, LEAST_S, MOST_S))
    count = max(2, round(seconds * FRAMES_A_S))
    drawn, colours, legend = _coloured(scene, look)
    words = overlay(Viewpoint(np.eye(4), (look.width_px, look.height_px), 1.0), legend, False) if look.legend else None
    for number, view in enumerate(flight(way, (look.width_px, look.height_px), count)):
        picture = rendered(drawn, colours, view)
        yield picture if words is None else laid_over(picture, words)
        progress((number + 1) / count, f"frame {number + 1} of {count}")
