"""Procedural road, pavement and lawn textures. A repeat of STREET is 12 m square, of AVENUE 18 m, of ASPHALT and CROSSING 6 m."""

from typing import Final

import numpy as np

from wayloom.simulation.textures.canvas import Canvas, Image, Mask, courses, finished, over
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.noise import Field

STREET_TILE_M = 12.0
AVENUE_TILE_M = 18.0
ASPHALT_TILE_M = 6.0
ASPHALT_ALBEDO = 0.15
WHITE_PAINT = 0.62
TRACK_GAUGE_M = 1.435
TRACK_OFFSET_M = 1.75
DASH_WIDTH_M, DASH_M, DASH_PERIOD_M = 0.13, 3.0, 6.0
"""Of the line between the lanes of a street."""
STREET_PARKING_M, AVENUE_PARKING_M = 3.75, 6.75
"""From a street's middle to the broken line before its parking strip."""
PARKING_WIDTH_M, PARKING_DASH_M, PARKING_PERIOD_M = 0.11, 1.0, 2.0
AVENUE_EDGE_M, AVENUE_EDGE_WIDTH_M = 3.6, 0.12
BAR_M, BAR_PERIOD_M = 0.5, 1.0
"""Of a zebra."""


def _asphalt(c: Canvas, patches: int) -> Image:
    """Grain, stains, cracks, and patches with tarred edges."""
    tone = ASPHALT_ALBEDO * (1 + 0.24 * c.noise(0.5, lowest=30) + 0.14 * c.noise(2.4))
    cracks = (np.abs(c.noise(2.8)) < 0.010) & (c.noise(3.0) > 0.3)
    tone = np.where(cracks, tone * 0.45, tone)
    for _ in range(patches):
        x0, y0 = c.rng.random(2) * 0.8
        w, h = c.rng.uniform(0.05, 0.16), c.rng.uniform(0.06, 0.25)
        inside = (c.x > x0) & (c.x < x0 + w) & (c.y > y0) & (c.y < y0 + h)
        core = (c.x > x0 + 0.004) & (c.x < x0 + w - 0.004) & (c.y > y0 + 0.004) & (c.y < y0 + h - 0.004)
        tone = np.where(inside, tone * c.rng.uniform(0.74, 1.2), tone)
        tone = np.where(inside & ~core, tone * 0.55, tone)
    return c.filled((1.0, 0.985, 0.96), np.asarray(tone, np.float32))


def _marked(c: Canvas, base: Image, mask: Mask, worn: float = 0.25) -> Image:
    """White paint, worn by random spots."""
    kept = np.clip(0.72 + worn * c.noise(1.4), 0.05, 1.0)[..., None]
    return over(mask, base * (1 - kept) + WHITE_PAINT * kept, base)


def _manhole(c: Canvas, base: Image, x: float, y: float, radius: float) -> Image:
    r = np.hypot(c.x - x, c.y - y)
    studs = (np.sin(c.x * 700) > 0) ^ (np.sin(c.y * 700) > 0)
    base = over(r < radius, np.where(studs, 0.14, 0.08)[..., None], base)
    return over((r >= radius) & (r < radius * 1.15), 0.04, base)


def _line(across: Field, at_m: float, width_m: float) -> Mask:
    return np.asarray(np.abs(across - at_m) < width_m / 2)


def _parking(across: Field, along: Field, at_m: float) -> Mask:
    """Broken lines on both sides."""
    lines = _line(across, -at_m, PARKING_WIDTH_M) | _line(across, at_m, PARKING_WIDTH_M)
    return np.asarray(lines & (along % PARKING_PERIOD_M < PARKING_DASH_M))


def street(c: Canvas) -> Image:
    """Two lanes with a dashed middle line and broken lines before the parking strips."""
    across, along = (c.x - 0.5) * STREET_TILE_M, c.y * STREET_TILE_M
    rgb = _asphalt(c, 4)
    dashes = _line(across, 0.0, DASH_WIDTH_M) & (along % DASH_PERIOD_M < DASH_M)
    parking = _parking(across, along, STREET_PARKING_M)
    rgb = _marked(c, rgb, np.asarray(dashes | parking))
    rgb = over(np.asarray(np.abs(across) > 5.72), rgb * 0.62, rgb)  # the gutter
    for x, y in ((0.36, 0.3), (0.66, 0.78)):
        rgb = _manhole(c, rgb, x, y, 0.026)
    return finished(rgb, 0.05)


def avenue(c: Canvas) -> Image:
    """Tram tracks in the middle, one lane each side, parking strips."""
    across, along = (c.x - 0.5) * AVENUE_TILE_M, c.y * AVENUE_TILE_M
    rgb = _asphalt(c, 3)
    bed = np.abs(across) < 3.4
    joints, tones = courses(c, 90, 90, 0.10, 0.10)
    rgb = over(np.asarray(bed), over(joints, 0.07, c.filled((0.21, 0.2, 0.19), 1 + 0.16 * tones)), rgb)
    for track in (-TRACK_OFFSET_M, TRACK_OFFSET_M):
        for rail in (track - TRACK_GAUGE_M / 2, track + TRACK_GAUGE_M / 2):
            rgb = over(_line(across, rail, 0.15), 0.05, rgb)
            rgb = over(_line(across, rail, 0.07), 0.42, rgb)
    edges = _line(across, -AVENUE_EDGE_M, AVENUE_EDGE_WIDTH_M) | _line(across, AVENUE_EDGE_M, AVENUE_EDGE_WIDTH_M)
    parking = _parking(across, along, AVENUE_PARKING_M)
    return finished(_marked(c, rgb, np.asarray(edges | parking)), 0.05)


def asphalt(c: Canvas) -> Image:
    """Unmarked asphalt of junctions."""
    return finished(_asphalt(c, 2), 0.05)


def crossing(c: Canvas) -> Image:
    """Zebra: bars of half a metre along the direction of travel."""
    return finished(_marked(c, _asphalt(c, 1), np.asarray(c.x * ASPHALT_TILE_M % BAR_PERIOD_M < BAR_M), 0.3), 0.05)


def pavers(c: Canvas) -> Image:
    """Slabs of 0.3 m; a repeat is 3 m."""
    joints, tones = courses(c, 10, 10, 0.045, 0.045)
    slabs = c.filled((0.34, 0.33, 0.31), 1 + 0.10 * tones + 0.12 * c.noise(0.8) + 0.08 * c.noise(2.4))
    return finished(over(joints, 0.13, slabs), 0.04)


def cobbles(c: Canvas) -> Image:
    """Setts of 0.1 m; a repeat is 2 m."""
    joints, tones = courses(c, 20, 20, 0.12, 0.12)
    stones = c.filled((0.27, 0.26, 0.25), 1 + 0.20 * tones + 0.12 * c.noise(1.0))
    return finished(over(joints, 0.08, stones), 0.04)


def lawn(c: Canvas) -> Image:
    """Grass with dry and dark spots; a repeat is 4 m."""
    tone = np.clip(0.6 + 0.30 * c.noise(0.6, lowest=16) + 0.2 * c.noise(1.8), 0.05, None)
    dry = np.clip(0.5 + 0.3 * c.noise(2.6), 0, 1)
    rgb = np.stack([(0.10 + 0.10 * dry) * tone, (0.17 + 0.04 * dry) * tone, 0.045 * tone + 0.008], -1)
    return finished(np.asarray(rgb, np.float32), 0.0)


def soil(c: Canvas) -> Image:
    """Earth and gravel; a repeat is 3 m."""
    return finished(c.filled((0.24, 0.19, 0.14), 1 + 0.30 * c.noise(0.5, lowest=12) + 0.2 * c.noise(2.2)), 0.0)


PAINTERS: Final = {
    Material.STREET: street,
    Material.AVENUE: avenue,
    Material.ASPHALT: asphalt,
    Material.CROSSING: crossing,
    Material.PAVERS: pavers,
    Material.COBBLES: cobbles,
    Material.LAWN: lawn,
    Material.SOIL: soil,
}
