"""Procedural facade, roof and masonry textures. A repeat of a front is 4 bays of 3 m by 4 floors of 3.1 m."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from wayloom.simulation.textures.canvas import Canvas, Image, courses, finished, over
from wayloom.simulation.textures.materials import Material

BAYS, FLOORS = 4, 4
BAY_M, FLOOR_M = 3.0, 3.1
WINDOW_GLOSS = 0.85
WINDOW_MIDDLE = 0.52
"""Height of a window's middle in its floor, from the top, share of the floor."""


@dataclass(frozen=True, slots=True)
class Style:
    """Look of a front: linear colour, wall ("plaster", "clinker", "panels", "ashlar"), window size as a share of the bay and floor,
    linear tones of frame and surround, and how many of ten windows have shutters."""

    rgb: tuple[float, float, float]
    wall: str
    window: tuple[float, float]
    frame: float
    surround: tuple[float, float, float]
    shutters: int = 0


STYLES: Final = {
    Material.PLASTER_CREAM: Style((0.62, 0.55, 0.42), "plaster", (0.42, 0.58), 0.65, (0.5, 0.42, 0.32), 4),
    Material.CLINKER: Style((0.34, 0.15, 0.10), "clinker", (0.42, 0.58), 0.6, (0.5, 0.45, 0.38)),
    Material.PLASTER_GREY: Style((0.46, 0.46, 0.45), "plaster", (0.6, 0.5), 0.15, (0.55, 0.55, 0.54)),
    Material.PLASTER_OCHRE: Style((0.58, 0.40, 0.20), "plaster", (0.38, 0.62), 0.6, (0.42, 0.2, 0.14), 6),
    Material.PANELS: Style((0.34, 0.35, 0.37), "panels", (0.78, 0.58), 0.10, (0.22, 0.22, 0.23)),
    Material.PLASTER_WHITE: Style((0.72, 0.70, 0.66), "plaster", (0.45, 0.52), 0.12, (0.6, 0.58, 0.54), 3),
    Material.SANDSTONE: Style((0.40, 0.26, 0.18), "ashlar", (0.40, 0.62), 0.55, (0.52, 0.4, 0.3)),
}


def _wall(c: Canvas, style: Style) -> Image:
    """The wall before windows are set in."""
    grime = 0.07 * c.noise(2.8)
    if style.wall == "clinker":
        joints, tones = courses(c, 48, 160, 0.06, 0.16)
        bricks = c.filled(style.rgb, 1 + 0.16 * tones + 0.10 * c.noise(1.0) + grime)
        return over(joints, np.asarray(style.rgb, np.float32) * 0.4 + 0.2, bricks)
    if style.wall == "ashlar":
        joints, tones = courses(c, 20, 32, 0.02, 0.03)
        return over(
            joints, np.asarray(style.rgb, np.float32) * 0.5, c.filled(style.rgb, 1 + 0.13 * tones + 0.10 * c.noise(0.8) + grime)
        )
    if style.wall == "panels":
        gaps = (c.x * 8 % 1 < 0.015) | (c.y * 8 % 1 < 0.02)
        return over(np.asarray(gaps), 0.08, c.filled(style.rgb, 1 + 0.08 * c.noise(1.4) + grime))
    return c.filled(style.rgb, 1 + 0.07 * c.noise(0.6, lowest=8) + 0.06 * c.noise(1.8) + grime)


def _streaks(c: Canvas, wall: Image) -> Image:
    """Dirt that rain has drawn down the wall, strongest under the sills."""
    walk = np.cumsum(c.rng.normal(0, 1, c.size)).astype(np.float32)
    walk = walk - np.linspace(walk[0], walk[-1], c.size, dtype=np.float32)  # so that it tiles
    strength = 0.05 * (0.4 + 0.6 * (c.y * FLOORS % 1.0))
    return np.asarray(wall * (1 + (strength * (walk / walk.std())[None])[..., None]), np.float32)


def front(style: Style, c: Canvas) -> Image:
    """A wall with a window in every bay of every floor: panes, frames, curtains, blinds, shutters, sills."""
    rgb = _streaks(c, _wall(c, style))
    bay, floor = c.x * BAYS, c.y * FLOORS
    which = (np.floor(bay) + BAYS * np.floor(floor)).astype(np.int64)
    dx, dy = np.abs(bay % 1 - 0.5) * BAY_M, (floor % 1 - WINDOW_MIDDLE) * FLOOR_M
    half_w, half_h = style.window[0] * BAY_M / 2, style.window[1] * FLOOR_M / 2
    pane = (dx < half_w) & (np.abs(dy) < half_h)
    frame = pane & ((dx > half_w - 0.09) | (np.abs(dy) > half_h - 0.09) | (dx < 0.04) | (np.abs(dy + half_h * 0.35) < 0.035))
    surround = (dx < half_w + 0.16) & (np.abs(dy) < half_h + 0.18) & ~pane
    sill = (dx < half_w + 0.22) & (dy > half_h) & (dy < half_h + 0.14)
    pick = c.rng.random((3, BAYS * FLOORS)).astype(np.float32)[:, which]
    glass = c.filled((0.9, 1.0, 1.1), (0.02 + 0.05 * pick[0]) * (1 + 0.3 * c.noise(2.2)))
    curtain = (pick[1] < 0.3) & (dx > half_w - 0.4)
    blind = (pick[1] > 0.3) & (pick[1] < 0.6) & (dy < -half_h + 2 * half_h * pick[2])
    slats = c.filled((0.5, 0.49, 0.46), 1 + 0.25 * np.sin(c.y * FLOORS * FLOOR_M * 2 * np.pi / 0.06))
    folds = c.filled((0.55, 0.53, 0.5), 1 + 0.2 * np.sin(c.x * BAYS * BAY_M * 2 * np.pi / 0.09))
    rgb = over(np.asarray(surround), style.surround, rgb)
    if style.shutters:
        wing = (dx > half_w + 0.03) & (dx < half_w + 0.03 + half_w * 0.9) & (np.abs(dy) < half_h) & (pick[0] * 10 < style.shutters)
        ribs = 1 + 0.35 * np.sin(c.y * FLOORS * FLOOR_M * 2 * np.pi / 0.08)
        rgb = over(np.asarray(wing), c.filled((0.13, 0.17, 0.11) if style.frame > 0.3 else (0.2, 0.12, 0.08), ribs), rgb)
    rgb = over(np.asarray(sill), 0.45, rgb)
    rgb = over(np.asarray(pane), over(np.asarray(curtain), folds, over(np.asarray(blind), slats, glass)), rgb)
    rgb = over(np.asarray(frame), style.frame, rgb)
    in_shade = pane & (dy + half_h < 0.2)
    rgb = over(np.asarray(in_shade), rgb * 0.4, rgb)
    rgb = over(np.asarray(c.y * FLOORS % 1 < 0.025), rgb * 0.78, rgb)
    return finished(rgb, np.where(pane & ~frame, WINDOW_GLOSS, 0.02))


def shop(c: Canvas) -> Image:
    """Ground floor with shop windows, goods behind them, and sign boards; a repeat is 12 m by 3.4 m."""
    rgb = c.filled((0.30, 0.27, 0.24), 1 + 0.12 * c.noise(1.4))
    unit, within = np.floor(c.x * 3).astype(np.int64), c.x * 3 % 1
    pane = (np.abs(within - 0.5) < 0.42) & (c.y > 0.30) & (c.y < 0.88)
    entrance = (np.abs(within - 0.72) < 0.12) & (c.y > 0.30)
    shelves = np.clip(0.08 + 0.05 * c.noise(1.6, lowest=5), 0.012, 1)
    hue = [1 + 0.25 * c.noise(2.2, lowest=3) for _ in range(3)]
    goods = np.stack([np.clip(shelves * h, 0.01, 1) for h in hue], -1)
    rgb = over(np.asarray(pane), goods, rgb)
    rgb = over(np.asarray(entrance), c.filled((0.06, 0.07, 0.08), 1 + 0.2 * c.noise(2.0)), rgb)
    mullion = (pane | entrance) & (
        (np.abs(within - 0.6) < 0.012) | (np.abs(within - 0.84) < 0.012) | (np.abs(within - 0.2) < 0.008)
    )
    rgb = over(np.asarray(mullion), 0.2, rgb)
    board = (c.y > 0.07) & (c.y < 0.24) & (np.abs(within - 0.5) < 0.46)
    colours = np.array([(0.35, 0.08, 0.06), (0.06, 0.13, 0.32), (0.75, 0.72, 0.6)], np.float32)[unit]
    letters = board & (c.y > 0.11) & (c.y < 0.20) & (np.abs(within - 0.5) < 0.3)
    strokes = np.repeat((c.rng.random(c.size // 8 + 1) < 0.55), 8)[: c.size][None] & (c.noise(0.6, lowest=20) > -0.6)
    ink = np.array([(0.85, 0.8, 0.7), (0.85, 0.85, 0.85), (0.1, 0.1, 0.12)], np.float32)[unit]
    rgb = over(np.asarray(letters & strokes), ink, over(np.asarray(board), colours, rgb))
    return finished(rgb, np.where((pane | entrance) & ~mullion, 0.6, 0.04))


def door(c: Canvas) -> Image:
    """A panelled house door with a pane and a frame; the whole texture is one door."""
    rgb = c.filled((0.16, 0.09, 0.05), 1 + 0.25 * np.roll(c.noise(1.6), 3, 0))
    frame = (c.x < 0.1) | (c.x > 0.9) | (c.y < 0.06)
    pane = (np.abs(c.x - 0.5) < 0.25) & (c.y > 0.12) & (c.y < 0.45)
    groove = (np.abs(np.abs(c.x - 0.5) - 0.3) < 0.012) | (np.abs(c.y - 0.7) < 0.01)
    rgb = over(np.asarray(pane), 0.04, over(np.asarray(groove), rgb * 0.4, rgb))
    return finished(over(np.asarray(frame), 0.55, rgb), np.where(pane, 0.6, 0.08))


def roof_tiles(c: Canvas) -> Image:
    """Pantiles; a repeat is 6 m."""
    v = c.y * 18
    u = c.x * 22
    tone = (1 + 0.12 * c.noise(1.2) + 0.10 * c.noise(2.6)) * (0.55 + 0.45 * (v % 1)) * (0.72 + 0.28 * np.abs(np.sin(np.pi * u)))
    _, tones = courses(c, 22, 18, 0.0, 0.0)
    return finished(c.filled((0.34, 0.15, 0.10), np.asarray(tone * (1 + 0.1 * tones), np.float32)), 0.02)


def brick(c: Canvas) -> Image:
    """Garden wall; a repeat is 3 m."""
    joints, tones = courses(c, 12, 40, 0.05, 0.14)
    return finished(
        over(joints, 0.30, c.filled((0.38, 0.20, 0.14), 1 + 0.18 * tones + 0.14 * c.noise(1.0) + 0.1 * c.noise(2.4))), 0.02
    )


def rubble(c: Canvas) -> Image:
    """Dry stone wall; a repeat is 3 m."""
    joints, tones = courses(c, 9, 18, 0.07, 0.11)
    stones = c.filled((0.33, 0.30, 0.26), 1 + 0.24 * tones + 0.2 * c.noise(1.2, lowest=4))
    return finished(over(joints, 0.07, stones), 0.02)


def concrete(c: Canvas) -> Image:
    """Plain concrete; a repeat is 4 m."""
    return finished(c.filled((0.38, 0.37, 0.35), 1 + 0.09 * c.noise(0.9) + 0.13 * c.noise(2.4)), 0.02)


PAINTERS: Final[dict[Material, Callable[[Canvas], Image]]] = {
    **{material: partial(front, style) for material, style in STYLES.items()},
    Material.SHOP: shop,
    Material.DOOR: door,
    Material.ROOF_TILES: roof_tiles,
    Material.BRICK: brick,
    Material.RUBBLE: rubble,
    Material.CONCRETE: concrete,
}
