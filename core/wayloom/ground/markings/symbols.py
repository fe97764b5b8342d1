"""Arrows and other symbols painted on the road: connected paint that is no straight line."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.bars import Bar
from wayloom.ground.markings.geometry import lifted, total_sigma
from wayloom.ground.markings.paint import ROAD, Paint
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.markings.types import Marking
from wayloom.ground.sheet import PIXEL_M

FloatArray = NDArray[np.float64]
STRONG: Final = 0.25
"""Paint of a symbol has this share of its contrast."""
LINE_SHARE, BLUR_PX = 0.85, 1.5
"""Paint of which this share lies on one straight axis is a line."""
STRENGTH: Final = 12.0
"""Contrast over the road's grain, median over the symbol: half of all symbols with it are believed."""
HEAD: Final = 1.8
"""An arrow's head is so many times as wide as its shaft."""
SHAFT_SHARE: Final = 0.35
SIMPLE_M: Final = 0.04
SPARSE: Final = 0.85
LEAST_BROAD_M: Final = 0.4
BORDER_M: Final = 0.5


def find_symbols(
    bars: list[Bar], crossings: list[Marking], raster: GroundRaster, paint: Paint, settings: MarkingSettings
) -> tuple[list[Marking], list[Bar]]:
    """The symbols outside the crossings, and the pieces that are no part of one."""
    owner = [int(paint.whole[_pixel(bar, paint)]) for bar in bars]
    found, symbols = [], set()
    low, high = (limit / PIXEL_M for limit in settings.symbol_length_m)
    for number in range(1, len(paint.facts)):
        x, y, w, h, area = (int(value) for value in paint.facts[number])
        extent = float(np.hypot(w, h))
        if not (low <= extent <= 1.5 * high and area * PIXEL_M**2 >= settings.symbol_area_m2[0]):
            continue
        box = (slice(max(0, y - 1), y + h + 1), slice(max(0, x - 1), x + w + 1))
        mine = [bar for bar, own in zip(bars, owner, strict=True) if own == number]
        symbol = _symbol(number, box, mine, raster, paint, settings)
        if symbol is not None and not any(_overlaps(symbol, crossing) for crossing in crossings):
            found.append(symbol)
            symbols.add(number)
    return found, [bar for bar, own in zip(bars, owner, strict=True) if own not in symbols]


def _overlaps(symbol: Marking, crossing: Marking) -> bool:
    """Whether a symbol's middle lies in a crossing or at its border."""
    x, y = symbol.line[:, :2].mean(axis=0).tolist()
    return bool(cv2.pointPolygonTest(crossing.ring[:, :2].astype(np.float32), (x, y), True) > -BORDER_M)


def _pixel(bar: Bar, paint: Paint) -> tuple[int, int]:
    """The pixel in a piece's middle."""
    column, row = np.clip(np.rint(bar.ends.mean(axis=0)).astype(int), 0, np.array(paint.whole.shape[::-1]) - 1)
    return int(row), int(column)


def _symbol(
    number: int, box: tuple[slice, slice], bars: list[Bar], raster: GroundRaster, paint: Paint, settings: MarkingSettings
) -> Marking | None:
    """The symbol of one connected patch of paint; None where it is a line, or no paint."""
    inside = paint.whole[box] == number
    contrast = paint.contrast[box]
    strong = inside & (contrast > STRONG * np.quantile(contrast[inside], 0.9))
    area = float(strong.sum()) * PIXEL_M**2
    rows, columns = np.nonzero(strong)
    places = np.column_stack([columns + box[1].start, rows + box[0].start]).astype(np.float64)
    if not settings.symbol_area_m2[0] <= area <= settings.symbol_area_m2[1] or _is_line(bars, places):
        return None
    (cx, cy), (w, h), turn = cv2.minAreaRect(places.astype(np.float32))
    long, short = max(w, h) + 1, min(w, h) + 1
    if not settings.symbol_length_m[0] <= long * PIXEL_M <= settings.symbol_length_m[1] or short * PIXEL_M < LEAST_BROAD_M:
        return None
    if len(places) / (long * short) > SPARSE:
        return None
    strength = float(np.median(contrast[strong]) / max(float(paint.grain[box][strong].mean()), 0.01))
    believed = float(1 / (1 + (STRENGTH / strength) ** 4))
    if believed < settings.least_confidence:
        return None
    cells = places.astype(np.int64) // 2
    if (raster.label[cells[:, 1], cells[:, 0]] == ROAD).mean() < 0.9:
        return None
    angle = np.radians(turn if w >= h else turn + 90.0)
    d = np.array([np.cos(angle), np.sin(angle)])
    kind, d = _kind(places - (cx, cy), d)
    middle = np.array([cx, cy])
    line = raster.xy(np.array([middle - d * long / 2, middle + d * long / 2]))
    ring = raster.xy(_contour(strong) + np.array([box[1].start, box[0].start]))
    return Marking(
        kind, lifted(line, raster), lifted(ring, raster), short * PIXEL_M, long * PIXEL_M,
        total_sigma(np.array([0.5, 0.5, 0.7]), line, raster, settings), believed,
    )  # fmt: skip


def _is_line(bars: list[Bar], places: FloatArray) -> bool:
    """Whether most of the paint (N, 2) px lies on the axis of one of its straight pieces."""
    shares = [0.0]
    for bar in bars:
        aside = (places - bar.ends[0]) @ np.array([-bar.d[1], bar.d[0]])
        shares.append(float((np.abs(aside) < bar.width_px / 2 + BLUR_PX).mean()))
    return max(shares) > LINE_SHARE


def _kind(places: FloatArray, d: FloatArray) -> tuple[str, FloatArray]:
    """ "arrow" with the direction to its tip, where the paint (N, 2) px about its middle is a shaft with a head; else "symbol"."""
    along, across = places @ d, places @ np.array([-d[1], d[0]])
    section = np.floor((along - along.min()) / 2.0).astype(np.int64)
    count = int(section.max()) + 1
    if count < 8:
        return "symbol", d
    widths = np.array([np.ptp(across[section == k]) + 1 if (section == k).any() else 0.0 for k in range(count)])
    for way in (1, -1):
        profile = widths[::way]
        shaft = profile[: max(3, int(SHAFT_SHARE * count))]
        head = int(np.argmax(profile))
        slim = float(np.median(shaft))
        tapers = head < count - 1 and profile[-1] < 0.6 * profile[head] and head >= 0.4 * count
        if slim > 0 and profile[head] >= HEAD * slim and tapers and shaft.max() < 1.5 * slim:
            return "arrow", d * way
    return "symbol", d


def _contour(mask: NDArray[np.bool_]) -> FloatArray:
    """(M, 2) column and row of the outline of the largest part, counter-clockwise as rows go up, closed."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(contours, key=cv2.contourArea)
    ring = cv2.approxPolyDP(largest, SIMPLE_M / PIXEL_M, True)[:, 0].astype(np.float64)
    x, y = ring.T
    if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0:
        ring = ring[::-1]
    return np.vstack([ring, ring[:1]])
