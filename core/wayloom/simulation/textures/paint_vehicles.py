"""Procedural vehicle textures, coloured by tint where they are light; u runs from back to front, v from top to bottom."""

from collections.abc import Callable
from typing import Final

import numpy as np

from wayloom.simulation.textures.canvas import Canvas, Image, Mask, finished, over
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.noise import Field

WINDOW_GLOSS, PAINT_GLOSS = 0.8, 0.32
RUBBER, CHROME, AMBER = 0.02, 0.5, (0.75, 0.42, 0.05)


def _lacquer(c: Canvas, dust: float = 0.25) -> Image:
    """White paint with dust that thickens towards the sill."""
    dirt = np.clip((c.y - 0.55) / 0.45, 0, 1) ** 1.5 * dust
    return c.filled((1.0, 1.0, 1.0), np.asarray(np.clip(0.93 - dirt + 0.03 * c.noise(2.2), 0.05, 1), np.float32))


def _box(c: Canvas, x0: float, x1: float, y0: float, y1: float) -> Mask:
    return np.asarray((c.x > x0) & (c.x < x1) & (c.y > y0) & (c.y < y1))


def _border(c: Canvas, x0: float, x1: float, y0: float, y1: float, width: float, aspect: float = 1.0) -> Mask:
    """The rim of a rectangle; `aspect` is how much longer than high the surface is."""
    w = width / aspect
    return np.asarray(_box(c, x0, x1, y0, y1) & ~_box(c, x0 + w, x1 - w, y0 + width, y1 - width))


def _inside(c: Canvas) -> Image:
    """What is dimly seen through a vehicle's window: seats, people, the far windows."""
    shade = np.clip(0.03 + 0.025 * c.noise(1.8, lowest=3), 0.006, 0.2)
    return c.filled((0.95, 1.0, 1.05), np.asarray(shade, np.float32))


def _words(c: Canvas, x0: float, x1: float, y0: float, y1: float, letters: int) -> Mask:
    """Strokes that look like a line of large letters."""
    columns = letters * 5
    rows = 7
    ink = c.rng.random((rows, columns)) < 0.62
    ink[:, 4::5] = False
    ink[:, ::5] |= c.rng.random((1, letters)) < 0.7
    i = np.clip(((c.y - y0) / (y1 - y0) * rows).astype(np.int64), 0, rows - 1)
    j = np.clip(((c.x - x0) / (x1 - x0) * columns).astype(np.int64), 0, columns - 1)
    return np.asarray(_box(c, x0, x1, y0, y1) & ink[i, j])


def _stripes(value: Field, count: float, share: float) -> Mask:
    return np.asarray((value * count % 1) < share)


def car_side(c: Canvas) -> Image:
    """Flank of a car below its windows, sill to belt: door gaps, handles, a moulding, dark sill."""
    rgb = _lacquer(c)
    gaps = np.zeros_like(c.x, dtype=bool)
    for x in (0.295, 0.50, 0.69):
        gaps |= (np.abs(c.x - x - 0.02 * (c.y - 0.5)) < 0.0022) & (c.y < 0.88)
    gaps |= (np.abs(c.y - 0.88) < 0.010) & (c.x > 0.295) & (c.x < 0.69)
    crease = np.exp(-(((c.y - 0.22) / 0.035) ** 2))
    rgb = np.asarray(rgb * (1 - 0.16 * crease + 0.10 * np.exp(-(((c.y - 0.30) / 0.03) ** 2)))[..., None], np.float32)
    handles = ((np.abs(c.x - 0.335) < 0.018) | (np.abs(c.x - 0.535) < 0.018)) & (np.abs(c.y - 0.16) < 0.022)
    moulding = (np.abs(c.y - 0.60) < 0.022) & (c.x > 0.24) & (c.x < 0.76)
    flap = np.abs(np.hypot((c.x - 0.14) * 4.6, c.y - 0.22) - 0.085) < 0.008
    blinker = (np.abs(c.x - 0.755) < 0.009) & (np.abs(c.y - 0.27) < 0.028)
    rgb = over(np.asarray(flap), rgb * 0.5, over(np.asarray(handles), rgb * 0.45, rgb))
    rgb = over(np.asarray(moulding), rgb * 0.35, over(np.asarray(blinker), AMBER, rgb))
    rgb = over(np.asarray(c.y > 0.90), 0.03, over(np.asarray(gaps), 0.02, rgb))
    return finished(rgb, np.where((c.y > 0.90) | gaps, 0.08, PAINT_GLOSS))


def car_back(c: Canvas) -> Image:
    """Rear of a car from boot lid to bumper: gaps, plate, badge; the lamps are bodies of their own."""
    rgb = _lacquer(c, 0.35)
    lid = _border(c, 0.16, 0.84, -0.2, 0.60, 0.016, 2.0)
    plate = _box(c, 0.34, 0.66, 0.30, 0.50)
    rgb = over(plate, 0.7, over(lid, 0.03, rgb))
    rgb = over(_words(c, 0.38, 0.64, 0.34, 0.46, 7), 0.03, over(_border(c, 0.34, 0.66, 0.30, 0.50, 0.015, 2.0), 0.05, rgb))
    badge = np.hypot((c.x - 0.5) * 2.4, c.y - 0.16) < 0.05
    rgb = over(np.asarray(badge), CHROME, rgb)
    rgb = over(np.asarray(np.abs(c.y - 0.66) < 0.012), 0.03, rgb)
    return finished(over(np.asarray(c.y > 0.86), 0.03, rgb), np.where(c.y > 0.86, 0.08, PAINT_GLOSS))


def car_front(c: Canvas) -> Image:
    """Front of a car from bonnet to bumper: grille, air intake, plate, badge."""
    rgb = _lacquer(c, 0.3)
    grille, intake = _box(c, 0.30, 0.70, 0.10, 0.34), _box(c, 0.22, 0.78, 0.66, 0.86)
    rgb = over(grille | intake, 0.02, rgb)
    rgb = over(grille & _stripes(c.y, 28, 0.4), 0.22, rgb)
    rgb = over(_border(c, 0.30, 0.70, 0.10, 0.34, 0.02, 2.0), CHROME, rgb)
    rgb = over(np.asarray(np.hypot((c.x - 0.5) * 2.4, c.y - 0.2) < 0.06), CHROME, rgb)
    plate = _box(c, 0.35, 0.65, 0.46, 0.60)
    rgb = over(_words(c, 0.39, 0.63, 0.48, 0.58, 7), 0.03, over(plate, 0.7, rgb))
    fog = (np.abs(np.abs(c.x - 0.5) - 0.36) < 0.045) & (np.abs(c.y - 0.76) < 0.06)
    rgb = over(np.asarray(fog), 0.3, rgb)
    return finished(over(np.asarray(c.y > 0.93), 0.03, rgb), np.where(grille | intake | (c.y > 0.93), 0.1, PAINT_GLOSS))


def truck_side(c: Canvas) -> Image:
    """Curtain side of a lorry: folds, straps, rails, a sign-writer's name, reflecting tape."""
    folds = 1 + 0.07 * np.sin(c.x * 2 * np.pi * 26 + 1.5 * c.noise(2.4)) + 0.03 * c.noise(1.6)
    grime = 1 - 0.4 * np.clip((c.y - 0.7) / 0.3, 0, 1)
    rgb = c.filled((0.9, 0.9, 0.9), np.asarray(folds * grime, np.float32))
    band = np.abs(c.y - 0.5 - 0.12 * np.sin(c.x * 3.4)) < 0.13
    rgb = over(np.asarray(band), rgb * np.array([0.14, 0.2, 0.42], np.float32), rgb)
    rgb = over(_words(c, 0.12, 0.86, 0.36, 0.62, 9), 0.85, rgb)
    rgb = over(_words(c, 0.20, 0.62, 0.72, 0.79, 16), 0.06, rgb)
    straps = _stripes(c.x, 11, 0.035)
    rgb = over(straps & (c.y > 0.06), rgb * 0.55, rgb)
    rgb = over(straps & (np.abs(c.y - 0.9) < 0.03), 0.25, rgb)
    rails = (c.y < 0.05) | (c.y > 0.955) | (c.x < 0.012) | (c.x > 0.988)
    rgb = over(np.asarray(rails), 0.36, rgb)
    tape = (np.abs(c.y - 0.945) < 0.010) & (c.x * 18 % 1 < 0.6)
    return finished(over(np.asarray(tape), (0.7, 0.55, 0.08), rgb), 0.06)


def truck_back(c: Canvas) -> Image:
    """Rear doors of a lorry: seam, hinges, locking bars, tape, frame."""
    rgb = c.filled((0.8, 0.8, 0.8), np.asarray(1 + 0.06 * c.noise(2.2) - 0.3 * np.clip((c.y - 0.6) / 0.4, 0, 1), np.float32))
    frame = _border(c, 0.0, 1.0, 0.0, 1.0, 0.045)
    bars = np.zeros_like(c.x, dtype=bool)
    for x in (0.17, 0.40, 0.60, 0.83):
        bars |= np.abs(c.x - x) < 0.012
    handles = bars & (np.abs(c.y - 0.62) < 0.05)
    hinges = ((c.x < 0.09) | (c.x > 0.91)) & _stripes(c.y, 5, 0.12)
    rgb = over(_words(c, 0.2, 0.8, 0.18, 0.34, 7), rgb * np.array([0.2, 0.25, 0.5], np.float32), rgb)
    rgb = over(np.asarray(np.abs(c.x - 0.5) < 0.008), 0.04, rgb)
    rgb = over(np.asarray(bars), 0.22, over(frame, 0.34, rgb))
    rgb = over(np.asarray(handles), 0.08, over(np.asarray(hinges), 0.2, rgb))
    tape = (_border(c, 0.05, 0.95, 0.05, 0.95, 0.016)) & (((c.x + c.y) * 14 % 1) < 0.6)
    return finished(over(np.asarray(tape), (0.62, 0.06, 0.04), rgb), 0.12)


def cab_front(c: Canvas) -> Image:
    """A lorry's face under its windscreen: name, slatted grille, steps, bumper."""
    rgb = _lacquer(c, 0.3)
    grille = _box(c, 0.16, 0.84, 0.14, 0.52)
    rgb = over(grille & _stripes(c.y, 22, 0.55), 0.03, rgb)
    rgb = over(_words(c, 0.36, 0.64, 0.03, 0.10, 6), 0.3, rgb)
    bumper = c.y > 0.64
    rgb = over(np.asarray(bumper), 0.10, rgb)
    lamps = (np.abs(np.abs(c.x - 0.5) - 0.37) < 0.08) & (np.abs(c.y - 0.74) < 0.07)
    plate = _box(c, 0.37, 0.63, 0.80, 0.90)
    rgb = over(np.asarray(lamps), 0.6, over(plate, 0.7, rgb))
    rgb = over(_words(c, 0.40, 0.61, 0.82, 0.88, 7), 0.03, rgb)
    rgb = over(np.asarray(np.abs(c.y - 0.58) < 0.012), 0.03, rgb)
    return finished(rgb, np.where(lamps, 0.45, 0.25))


def _window_band(c: Canvas, windows: int, top: float, foot: float, doors: tuple[int, ...]) -> tuple[Mask, Mask]:
    """Panes of a row of windows, in which some bays are doors glazed to the floor; and the frames around them."""
    bay, within = np.floor(c.x * windows).astype(np.int64), c.x * windows % 1
    is_door = np.isin(bay, doors)
    low = np.where(is_door, 0.88, foot)
    pane = (np.abs(within - 0.5) < 0.465) & (c.y > top) & (c.y < low)
    post = is_door & (np.abs(within - 0.5) < 0.03)
    frame = (np.abs(within - 0.5) < 0.495) & (c.y > top - 0.015) & (c.y < low + 0.015) & ~pane
    return np.asarray(pane & ~post), np.asarray(frame | (post & pane))


def bus_side(c: Canvas) -> Image:
    """A whole side of a bus: tinted windows, doors, stripe, flaps, posters, wheel arches."""
    rgb = _lacquer(c, 0.3)
    rgb = over(np.asarray((c.y > 0.60) & (c.y < 0.64)), 0.75, rgb)
    rgb = over(_words(c, 0.36, 0.58, 0.68, 0.80, 9), 0.8, rgb)
    flaps = (_stripes(c.x, 13, 0.018) & (c.y > 0.62)) | (np.abs(c.y - 0.62) < 0.004)
    rgb = over(np.asarray(flaps), 0.05, rgb)
    pane, frame = _window_band(c, 9, 0.13, 0.53, (2, 5, 8))
    rgb = over(frame, 0.02, over(pane, _inside(c), rgb))
    people = (
        pane & (c.y > 0.34) & (np.abs(c.x * 27 % 1 - 0.5) < 0.22) & (c.rng.random(27)[np.floor(c.x * 27).astype(np.int64)] < 0.5)
    )
    rgb = over(np.asarray(people), np.array([0.05, 0.045, 0.06], np.float32), rgb)
    vents = (c.y < 0.03) | (c.y > 0.965)
    rgb = over(np.asarray(vents), 0.06, rgb)
    return finished(rgb, np.where(pane, WINDOW_GLOSS, PAINT_GLOSS))


def bus_front(c: Canvas) -> Image:
    """Face of a bus or tram: line and place in amber dots, windscreen in two halves with wipers, lamps, bumper."""
    rgb = _lacquer(c, 0.3)
    screen = _box(c, 0.05, 0.95, 0.20, 0.66)
    board = _box(c, 0.14, 0.86, 0.04, 0.16)
    rgb = over(screen, _inside(c) * 0.8, over(board, 0.012, rgb))
    dots = _words(c, 0.18, 0.30, 0.06, 0.14, 2) | _words(c, 0.36, 0.82, 0.07, 0.13, 9)
    rgb = over(dots, (0.9, 0.5, 0.05), rgb)
    driver = np.hypot((c.x - 0.74) * 1.4, (c.y - 0.5)) < 0.09
    wheel = np.abs(np.hypot((c.x - 0.74) * 1.2, (c.y - 0.64) * 2) - 0.11) < 0.012
    rgb = over(np.asarray((driver | wheel) & screen), 0.035, rgb)
    wipers = (np.abs(c.y - 0.66 + 0.75 * np.abs(c.x - 0.5) * 0.7) < 0.006) & screen
    rgb = over(np.asarray(wipers | (np.abs(c.x - 0.5) < 0.004) & screen), 0.01, rgb)
    lamps = (np.abs(np.abs(c.x - 0.5) - 0.36) < 0.085) & (np.abs(c.y - 0.78) < 0.045)
    rgb = over(np.asarray(np.abs(c.y - 0.70) < 0.006), 0.05, rgb)
    rgb = over(np.asarray(lamps), 0.7, over(np.asarray(c.y > 0.88), 0.05, rgb))
    plate = _box(c, 0.40, 0.60, 0.885, 0.935)
    return finished(over(plate, 0.65, rgb), np.where(screen, WINDOW_GLOSS, np.where(board, 0.4, PAINT_GLOSS)))


def bus_back(c: Canvas) -> Image:
    """Rear of a bus: high window, engine grille, clusters of round lamps, poster, plate."""
    rgb = _lacquer(c, 0.4)
    pane = _box(c, 0.10, 0.90, 0.10, 0.40)
    rgb = over(_border(c, 0.09, 0.91, 0.09, 0.41, 0.015), 0.03, over(pane, _inside(c), rgb))
    poster = _box(c, 0.16, 0.84, 0.46, 0.66)
    rgb = over(_words(c, 0.2, 0.8, 0.50, 0.62, 8), (0.5, 0.06, 0.05), over(poster, 0.7, rgb))
    grille = _box(c, 0.22, 0.78, 0.70, 0.86) & _stripes(c.y, 50, 0.55)
    rgb = over(grille, 0.03, rgb)
    for k, colour in enumerate(((0.6, 0.03, 0.02), AMBER, (0.6, 0.03, 0.02), (0.6, 0.6, 0.58))):
        lamp = np.hypot(np.abs(c.x - 0.5) - 0.42, (c.y - 0.50 - 0.085 * k) * 1.15) < 0.034
        rgb = over(np.asarray(lamp), colour, rgb)
    plate = _box(c, 0.40, 0.60, 0.885, 0.935)
    rgb = over(plate, 0.65, over(np.asarray(c.y > 0.95), 0.04, rgb))
    return finished(rgb, np.where(pane, WINDOW_GLOSS, PAINT_GLOSS))


def tram_side(c: Canvas) -> Image:
    """A section of a tram: large windows, a double door, a dark roof line, skirts over the bogies."""
    rgb = _lacquer(c, 0.35)
    rgb = over(np.asarray(c.y > 0.80), rgb * 0.35, rgb)
    rgb = over(np.asarray(c.y < 0.06), 0.2, rgb)
    pane, frame = _window_band(c, 6, 0.16, 0.52, (1, 4))
    rgb = over(frame, 0.03, over(pane, _inside(c), rgb))
    rgb = over(np.asarray((c.y > 0.56) & (c.y < 0.60)), 0.8, rgb)
    rgb = over(_words(c, 0.36, 0.64, 0.64, 0.74, 10), 0.8, rgb)
    gaps = (_stripes(c.x, 8, 0.012) & (c.y > 0.80)) | (np.abs(c.y - 0.80) < 0.005) | (c.x < 0.006) | (c.x > 0.994)
    bogies = (np.abs(np.abs(c.x - 0.5) - 0.27) < 0.10) & (c.y > 0.90)
    return finished(over(np.asarray(gaps | bogies), 0.03, rgb), np.where(pane, WINDOW_GLOSS, PAINT_GLOSS))


PAINTERS: Final[dict[Material, Callable[[Canvas], Image]]] = {
    Material.CAR_SIDE: car_side,
    Material.CAR_BACK: car_back,
    Material.CAR_FRONT: car_front,
    Material.TRUCK_SIDE: truck_side,
    Material.TRUCK_BACK: truck_back,
    Material.CAB_FRONT: cab_front,
    Material.BUS_SIDE: bus_side,
    Material.BUS_FRONT: bus_front,
    Material.BUS_BACK: bus_back,
    Material.TRAM_SIDE: tram_side,
}
