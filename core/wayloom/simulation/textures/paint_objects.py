"""Procedural textures of plants, fences, metal, clothes, signs and lights; the fourth channel of cut-outs is coverage."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.textures.canvas import Canvas, Image, finished, over
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.noise import Field

SIGN_COLUMNS, SIGN_ROWS = 4, 2
RED, BLUE, WHITE, YELLOW, BLACK = (0.55, 0.02, 0.02), (0.03, 0.12, 0.5), 0.78, (0.75, 0.5, 0.03), 0.02


def bark(c: Canvas) -> Image:
    """Furrows along the trunk."""
    furrows = c.noise(1.6)[:, (np.arange(c.size) * 3) % c.size]
    return finished(c.filled((0.17, 0.13, 0.10), np.clip(1 + 0.45 * furrows + 0.2 * c.noise(1.0), 0.1, 3)), 0.0)


def _blades(c: Canvas, count: int, spread: float, length: tuple[float, float], slim: float, rgb: tuple[float, ...]) -> Image:
    """Ellipses strewn around the middle, each with its own tone, darker towards its edges."""
    out = np.zeros((c.size, c.size, 4), np.float32)
    out[..., :3] = np.asarray(rgb, np.float32) * 0.8
    for _ in range(count):
        cx, cy = c.rng.normal(0.5, spread, 2)
        r, turn = c.rng.uniform(*length), c.rng.random() * np.pi
        tone = c.rng.uniform(0.45, 1.5) * np.array([c.rng.uniform(0.7, 1.5), 1.0, 1.0], np.float32)
        x0, x1, y0, y1 = (int(np.clip(v * c.size, 0, c.size)) for v in (cx - r, cx + r, cy - r, cy + r))
        x, y = c.x[y0:y1, x0:x1] - cx, c.y[y0:y1, x0:x1] - cy
        along, across = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
        inside = (along / r) ** 2 + (across / (r * slim)) ** 2 < 1
        shade = 1 - 0.35 * np.abs(across[inside, None]) / (r * slim)
        out[y0:y1, x0:x1, :3][inside] = np.asarray(rgb) * tone * shade
        out[y0:y1, x0:x1, 3][inside] = 1.0
    return out


def leaves(c: Canvas) -> Image:
    """A spray of broad leaves."""
    return _blades(c, 420, 0.19, (0.018, 0.04), 0.5, (0.10, 0.165, 0.035))


def needles(c: Canvas) -> Image:
    """A spray of needles."""
    return _blades(c, 900, 0.18, (0.02, 0.05), 0.14, (0.045, 0.085, 0.035))


def hedge(c: Canvas) -> Image:
    """Dense clipped leaves; a repeat is 1.5 m."""
    tone = np.clip(0.55 + 0.38 * c.noise(0.7, lowest=14) + 0.2 * c.noise(2.0), 0.06, None)
    return finished(np.asarray(np.stack([0.085 * tone + 0.008, 0.145 * tone + 0.01, 0.035 * tone + 0.004], -1), np.float32), 0.0)


def rails(c: Canvas) -> Image:
    """Iron bars between two rails; a repeat is 2 m long and as high as the fence."""
    bars = (c.x * 16 % 1 < 0.2) | (np.abs(c.y - 0.12) < 0.025) | (np.abs(c.y - 0.88) < 0.025)
    bars |= c.x < 0.03
    return finished(c.filled((0.05, 0.06, 0.055), 1 + 0.3 * c.noise(1.4)), np.asarray(bars, np.float32))


def pickets(c: Canvas) -> Image:
    """Wooden boards with gaps; a repeat is 2 m long and as high as the fence."""
    boards = ((c.x * 14 % 1 < 0.72) & (c.y > 0.04)) | (np.abs(c.y - 0.25) < 0.04) | (np.abs(c.y - 0.8) < 0.04)
    tones = c.rng.normal(0, 1, 14).astype(np.float32)[np.floor(c.x * 14).astype(np.int64)]
    grain = c.noise(1.8)[(np.arange(c.size) // 6), :]
    return finished(c.filled((0.30, 0.21, 0.13), 1 + 0.14 * tones + 0.2 * grain), np.asarray(boards, np.float32))


def mesh(c: Canvas) -> Image:
    """Welded wire with posts; a repeat is 2 m long and as high as the fence."""
    wires = (c.x * 20 % 1 < 0.16) | (c.y * 8 % 1 < 0.10) | (c.x < 0.03) | (c.x > 0.97)
    return finished(c.filled((0.08, 0.15, 0.09), 1 + 0.2 * c.noise(1.4)), np.asarray(wires, np.float32))


def metal(c: Canvas) -> Image:
    """Galvanised steel."""
    return finished(c.filled((0.25, 0.26, 0.27), 1 + 0.13 * c.noise(1.8) + 0.06 * c.noise(1.0)), 0.22)


def paint(c: Canvas) -> Image:
    """White lacquer, coloured by tint, slightly dusty."""
    return finished(c.filled((1.0, 1.0, 1.0), np.clip(0.93 + 0.03 * c.noise(2.4), 0, 1)), 0.32)


def glass(c: Canvas) -> Image:
    """Dark tinted glass."""
    return finished(c.filled((0.028, 0.033, 0.036), 1 + 0.2 * c.noise(2.4)), 0.85)


def _wheel_radius(c: Canvas) -> tuple[Field, Field]:
    return np.hypot(c.x - 0.5, c.y - 0.5), np.arctan2(c.y - 0.5, c.x - 0.5)


def wheel(c: Canvas) -> Image:
    """A tyre around a spoked rim; the wheel's edge is at radius 0.45."""
    r, angle = _wheel_radius(c)
    rgb = c.filled((0.025, 0.025, 0.026), 1 + 0.3 * c.noise(1.0))
    rgb = over(np.asarray(r < 0.31), c.filled((0.36, 0.36, 0.38), 1 + 0.1 * c.noise(2.0)), rgb)
    gaps = (r > 0.08) & (r < 0.28) & (np.sin(angle * 5) > 0.2)
    return finished(over(np.asarray(gaps), 0.03, rgb), np.where((r < 0.31) & ~gaps, 0.35, 0.03))


def spokes(c: Canvas) -> Image:
    """A bicycle's wheel: tyre, rim and thin spokes; holes between them."""
    r, angle = _wheel_radius(c)
    tyre, rim, hub = (r > 0.405) & (r < 0.47), (r > 0.375) & (r <= 0.405), r < 0.035
    wire = (r < 0.40) & (np.abs(np.sin(angle * 9)) * r < 0.016)
    rgb = over(np.asarray(rim | wire | hub), 0.4, c.filled((0.03, 0.03, 0.03), 1 + 0.2 * c.noise(1.0)))
    return finished(rgb, np.asarray(tyre | rim | hub | wire, np.float32))


def signs(c: Canvas) -> Image:
    """Eight plates, SIGN_COLUMNS by SIGN_ROWS: no entry, no parking, speed limit, give way; direction, priority, parking, zebra."""
    out = np.zeros((c.size, c.size, 4), np.float32)
    column, row = np.floor(c.x * SIGN_COLUMNS).astype(np.int64), np.floor(c.y * SIGN_ROWS).astype(np.int64)
    x, y = (c.x * SIGN_COLUMNS % 1 - 0.5) * 2.1, (c.y * SIGN_ROWS % 1 - 0.5) * 2.1
    r = np.hypot(x, y)
    disc, square, diamond = r < 1, (np.abs(x) < 0.97) & (np.abs(y) < 0.97), np.abs(x) + np.abs(y) < 1.02
    triangle = (y < 0.85) & (y > -0.85) & (np.abs(x) < (0.85 - y) / 1.7 + 0.02)  # point down
    zebra_man = (np.abs(x) < 0.5 - 0.5 * np.abs(y)) & (y > -0.5)
    letter_p = ((np.abs(x + 0.25) < 0.14) & (np.abs(y) < 0.62)) | (
        (np.abs(np.hypot(x + 0.02, y + 0.25) - 0.30) < 0.10) & (x > -0.25)
    )
    ring = disc & (r > 0.74)
    digits = (np.abs(np.abs(x) - 0.3) < 0.2) & (np.abs(y) < 0.38) & ~((np.abs(np.abs(x) - 0.3) < 0.08) & (np.abs(y) < 0.25))
    arrow = ((np.abs(y + 0.05) < 0.1) & (np.abs(x) < 0.55)) | ((np.abs(y + 0.05) < 0.62 - x * 1.1) & (x > 0.15) & (x < 0.6))
    inner_triangle = (y > -0.62) & (np.abs(x) < (0.85 - y) / 1.7 - 0.26)
    plates: list[tuple[NDArray[np.bool_], list[tuple[NDArray[np.bool_], float | tuple[float, ...]]]]] = [
        (disc, [(disc, RED), ((np.abs(x) < 0.72) & (np.abs(y) < 0.17), WHITE)]),
        (disc, [(disc, BLUE), (ring | (np.abs(x - y) < 0.18) & disc, RED)]),
        (disc, [(disc, WHITE), (ring, RED), (digits, BLACK)]),
        (triangle, [(triangle, RED), (inner_triangle, WHITE)]),
        (disc, [(disc, BLUE), (arrow, WHITE)]),
        (diamond, [(diamond, WHITE), (np.abs(x) + np.abs(y) < 0.72, YELLOW)]),
        (square, [(square, BLUE), (letter_p, WHITE)]),
        (square, [(square, BLUE), ((np.abs(x) < 0.7 - 0.5 * y) & (np.abs(y) < 0.7), WHITE), (zebra_man, BLACK)]),
    ]
    for k, (shape, inks) in enumerate(plates):
        here = (column == k % SIGN_COLUMNS) & (row == k // SIGN_COLUMNS)
        for mask, ink in inks:
            out[here & mask, :3] = ink
        out[here & shape, 3] = 1.0
    out[..., :3] = np.clip(out[..., :3] * (1 + 0.05 * c.noise(2.0)[..., None]), 0, 0.95)
    return out


def lamps(c: Canvas) -> Image:
    """A traffic light's face: red lit, amber and green dark, with visors."""
    rgb = c.filled((0.02, 0.02, 0.022), 1 + 0.1 * c.noise(1.5))
    for k, colour in enumerate(((0.95, 0.06, 0.03), (0.16, 0.10, 0.02), (0.01, 0.10, 0.05))):
        r = np.hypot((c.x - 0.5), (c.y - (k + 0.5) / 3) * 3)
        rgb = over(np.asarray(r < 0.36), colour, over(np.asarray(r < 0.43), 0.01, rgb))
    return finished(rgb, 0.08)


def cloth(c: Canvas) -> Image:
    """Woven cloth with folds, coloured by tint."""
    return finished(c.filled((1.0, 1.0, 1.0), np.clip(0.6 + 0.16 * c.noise(2.4) + 0.06 * c.noise(0.8), 0.05, 1)), 0.0)


def jacket(c: Canvas) -> Image:
    """A jacket around its wearer (u, front and back seam at 0.25 and 0.75), coloured by tint: folds, zip, pockets, hem."""
    folds = np.clip(0.62 + 0.15 * c.noise(2.6, lowest=2) + 0.05 * c.noise(0.9), 0.05, 1)
    rgb = c.filled((1.0, 1.0, 1.0), np.asarray(folds, np.float32))
    seams = np.abs((c.x - 0.25) % 0.5 - 0.0) < 0.008
    pockets = (np.abs(np.abs(c.x - 0.25) - 0.09) < 0.035) & (np.abs(c.y - 0.78) < 0.015)
    rgb = over(np.asarray(seams | pockets | (c.y > 0.95)), rgb * 0.45, rgb)
    return finished(over(np.asarray(np.abs(c.y - 0.38) < 0.02), rgb * 1.25, rgb), 0.0)


def lit(c: Canvas) -> Image:
    """The ribbed cover of a lamp that is on, coloured by tint."""
    ribs = 0.85 + 0.1 * np.sin(c.x * 2 * np.pi * 12) + 0.05 * np.sin(c.y * 2 * np.pi * 12)
    return finished(c.filled((1.0, 1.0, 1.0), np.asarray(ribs, np.float32)), 0.2)


PAINTERS: Final = {
    Material.BARK: bark,
    Material.LEAVES: leaves,
    Material.NEEDLES: needles,
    Material.HEDGE: hedge,
    Material.RAILS: rails,
    Material.PICKETS: pickets,
    Material.MESH: mesh,
    Material.METAL: metal,
    Material.PAINT: paint,
    Material.GLASS: glass,
    Material.WHEEL: wheel,
    Material.SPOKES: spokes,
    Material.SIGNS: signs,
    Material.LAMPS: lamps,
    Material.CLOTH: cloth,
    Material.LIT: lit,
    Material.JACKET: jacket,
}
