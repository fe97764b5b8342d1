"""Road markings on a raster of the ground: paint → straight pieces → crossings, symbols, lines."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.bars import Bar, bars_of
from wayloom.ground.markings.crossings import find_crossings
from wayloom.ground.markings.geometry import confidence, lifted, outline, total_sigma
from wayloom.ground.markings.paint import Paint, find_paint
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.markings.symbols import find_symbols
from wayloom.ground.markings.types import Marking
from wayloom.ground.sheet import PIXEL_M

FloatArray = NDArray[np.float64]
LEAST_PIXELS: Final = 10
LEAST_ON_ROAD: Final = 0.5
NEAR_M: Final = 20.0
"""How far around a line others tell which way the traffic goes."""
STRAIGHT_RAD, BEND_RAD = np.radians(4.0), np.radians(25.0)
LIKELY, ROW_M, ROW_ASIDE_M, ROW_TURN, ROW_RAD, MOST_ROWS = 0.5, 10.0, 0.08, 0.02, np.radians(6.0), 2
"""A row: pieces that are probable by themselves, within ROW_M along and ROW_ASIDE_M + ROW_TURN x distance aside."""
SHORT_M, ALONE = 1.5, 0.9
"""Shorter pieces that are in no row need this confidence."""
ASIDE_M: Final = 0.12
"""How far a line's continuation may lie to its side."""
OVERLAP_PX: Final = 25.0
"""Pieces of one bend are looked at a little beyond their ends."""
STEP_BESIDE_M, STEP_M, STEP_SIGMAS = 0.25, 0.04, 1.0
UNSEEN_SHARE: Final = 0.6
CROSSWISE_RAD: Final = np.radians(60.0)


def find_markings(raster: GroundRaster, settings: MarkingSettings = MarkingSettings()) -> list[Marking]:
    """All markings, in the raster's frame, without those that are less probable than `least_confidence`."""
    paint = find_paint(raster, settings)
    pieces = _pieces(raster, paint, settings)
    crossings, rest = find_crossings(pieces, raster, settings)
    symbols, rest = find_symbols(rest, crossings, raster, paint, settings)
    chains = _chains(without_doubles(_sound(rest, settings)), paint, settings)
    lines = [chain for chain in chains if _length_m(chain) >= settings.least_length_m and not _is_step(chain, raster)]
    found = crossings + symbols + _lines(lines, crossings, raster, settings)
    return [marking for marking in found if marking.confidence >= settings.least_confidence]


def _pieces(raster: GroundRaster, paint: Paint, settings: MarkingSettings) -> list[Bar]:
    """The straight pieces of all groups of pixels that hold paint."""
    rows, columns = np.nonzero(paint.group)
    group = paint.group[rows, columns]
    order = np.argsort(group, kind="stable")
    start = np.searchsorted(group[order], np.arange(int(paint.group.max()) + 2))
    out: list[Bar] = []
    for number in range(1, len(start) - 1):
        mine = order[start[number] : start[number + 1]]
        if len(mine) < LEAST_PIXELS or paint.contrast[rows[mine], columns[mine]].max() < settings.contrast:
            continue
        out += bars_of(np.column_stack([columns[mine], rows[mine]]).astype(np.float64), raster, paint, settings)
    return [bar for bar in out if bar.on_road >= LEAST_ON_ROAD]


def _sound(bars: list[Bar], settings: MarkingSettings) -> list[Bar]:
    """Pieces that are as wide as lines are, and more probable than not, by themselves or in a row with others."""
    widths = (settings.least_width_m / PIXEL_M, settings.most_width_m / PIXEL_M)
    fitting = [bar for bar in bars if widths[0] <= bar.width_px <= widths[1]]
    return [bar for bar in in_rows(fitting) if confidence(bar) > (ALONE if _is_alone(bar) else settings.least_confidence)]


def _is_alone(bar: Bar) -> bool:
    """Whether a piece is short and in no row: a strip of sun between shadows may look like it."""
    return bar.rows == 0 and bar.length_px * PIXEL_M < SHORT_M


def without_doubles(bars: list[Bar]) -> list[Bar]:
    """The bars without those that lie on a longer one."""
    order = sorted(range(len(bars)), key=lambda k: (-bars[k].length_px, k))
    kept: list[int] = []
    for k in order:
        places = np.linspace(bars[k].ends[0], bars[k].ends[1], 11)
        if not any(_covers(bars[other], places) for other in kept):
            kept.append(k)
    return [bars[k] for k in sorted(kept)]


def _covers(bar: Bar, places: FloatArray) -> bool:
    """Whether most of the places (N, 2) px lie on a bar."""
    along, aside = (places - bar.ends[0]) @ bar.d, (places - bar.ends[0]) @ np.array([-bar.d[1], bar.d[0]])
    on = (along > -2) & (along < bar.length_px + 2) & (np.abs(aside) < bar.width_px / 2 + 1.5)
    return bool(on.mean() > 0.6)


def _is_step(chain: list[Bar], raster: GroundRaster) -> bool:
    """Whether the ground is higher on one side of a line than on the other: then the bright line is a kerb's stone."""
    steps = []
    for bar in chain:
        middles = np.linspace(bar.ends[0], bar.ends[1], 7)
        aside = np.array([-bar.d[1], bar.d[0]]) * (bar.width_px / 2 + STEP_BESIDE_M / PIXEL_M)
        left, right = (raster.xy(middles + sign * aside) for sign in (1.0, -1.0))
        sigma = np.fmax(raster.sigma(left), raster.sigma(right))
        steps.append((np.abs(raster.z(left) - raster.z(right)) - STEP_SIGMAS * sigma) > STEP_M)
    return bool(np.concatenate(steps).mean() > 0.5)


def in_rows(bars: list[Bar]) -> list[Bar]:
    """The bars, those that lie in one line with probable others believed more."""
    likely = [bar for bar in bars if confidence(bar) > LIKELY]
    if not likely:
        return bars
    middles, ds = np.array([bar.ends.mean(axis=0) for bar in likely]), np.array([bar.d for bar in likely])
    widths = np.array([bar.width_px for bar in likely])
    out = []
    for bar in bars:
        step = middles - bar.ends.mean(axis=0)
        along, aside = step @ bar.d, np.abs(step @ np.array([-bar.d[1], bar.d[0]]))
        aligned = (np.abs(ds @ bar.d) > np.cos(ROW_RAD)) & (np.abs(np.log(widths / bar.width_px)) < np.log(2.0))
        reach = (np.abs(along) < ROW_M / PIXEL_M) & (np.abs(along) > 5.0)
        rows = aligned & reach & (aside < ROW_ASIDE_M / PIXEL_M + ROW_TURN * np.abs(along))
        out.append(replace(bar, rows=min(int(rows.sum()), MOST_ROWS)))
    return out


def _chains(bars: list[Bar], paint: Paint, settings: MarkingSettings) -> list[list[Bar]]:
    """Pieces that continue each other, each turned so that they follow one another; the nearest continuation first."""
    pairs = sorted(_continuations(bars, paint, settings))
    taken: dict[tuple[int, int], tuple[int, int]] = {}
    parent = list(range(len(bars)))

    def root(k: int) -> int:
        while parent[k] != k:
            k = parent[k]
        return k

    for _, a, end_a, b, end_b in pairs:
        if (a, end_a) in taken or (b, end_b) in taken or root(a) == root(b):
            continue
        taken[a, end_a], taken[b, end_b] = (b, end_b), (a, end_a)
        parent[root(b)] = root(a)
    return [_followed(k, bars, taken) for k in _starts(len(bars), taken)]


def _continuations(bars: list[Bar], paint: Paint, settings: MarkingSettings) -> list[tuple[float, int, int, int, int]]:
    """(gap, piece, its end, other piece, its end) where one may continue the other."""
    if len(bars) < 2:
        return []
    ends = np.array([bar.ends for bar in bars])
    far = max(settings.hidden_gap_m, settings.worn_gap_m) / PIXEL_M
    out = []
    for a in range(len(bars)):
        for end_a in (0, 1):
            gaps = np.linalg.norm(ends[a + 1 :] - ends[a, end_a], axis=2)
            for b, end_b in zip(*np.nonzero(gaps < far), strict=True):
                other = a + 1 + int(b)
                if _continues(bars[a], end_a, bars[other], int(end_b), paint, settings):
                    out.append((float(gaps[b, end_b]), a, end_a, other, int(end_b)))
    return out


def _continues(one: Bar, end: int, other: Bar, other_end: int, paint: Paint, settings: MarkingSettings) -> bool:
    """Whether a piece goes on in another: on one line where paint is worn off or nothing is seen, or in a bend without a gap."""
    out = one.d if end == 1 else -one.d
    on = other.d if other_end == 0 else -other.d
    gap = other.ends[other_end] - one.ends[end]
    ahead, length = float(gap @ out), float(np.hypot(*gap))
    turn = float(np.arccos(np.clip(out @ on, -1, 1)))
    aside = abs(float(gap[0] * -out[1] + gap[1] * out[0])) * PIXEL_M
    similar = 0.5 < one.width_px / other.width_px < 2.0
    if not similar or ahead < -OVERLAP_PX or aside > ASIDE_M + np.tan(BEND_RAD) * max(ahead, 0.0) * PIXEL_M:
        return False
    beyond = float((other.ends[1 - other_end] - one.ends[end]) @ out)
    behind = float((other.ends[other_end] - one.ends[1 - end]) @ out)
    if beyond < 0 or behind < 0:
        return False
    if length * PIXEL_M <= settings.worn_gap_m or (ahead < 0 and aside < ASIDE_M):
        return bool(turn < BEND_RAD)
    straight = bool(turn < STRAIGHT_RAD and aside < ASIDE_M)
    return straight and bool(one.open[end] and other.open[other_end]) and _unseen(one.ends[end], other.ends[other_end], paint)


def _unseen(p: FloatArray, q: FloatArray, paint: Paint) -> bool:
    """Whether most of the way from p to q (2,) px is not seen."""
    at = np.rint(np.linspace(p, q, 21)).astype(np.int64)
    rows, columns = paint.seen.shape
    seen = paint.seen[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, columns - 1)]
    return bool(1 - seen.mean() >= UNSEEN_SHARE)


def _starts(count: int, taken: dict[tuple[int, int], tuple[int, int]]) -> list[int]:
    """The first piece of each chain: of its two last ones that with the lower number."""
    out, visited = [], set()
    for k in range(count):
        if k in visited or ((k, 0) in taken and (k, 1) in taken):
            continue
        out.append(k)
        at, end = k, 1 if (k, 1) in taken else 0
        visited.add(k)
        while (at, end) in taken:
            at, into = taken[at, end]
            visited.add(at)
            end = 1 - into
    return out


def _followed(start: int, bars: list[Bar], taken: dict[tuple[int, int], tuple[int, int]]) -> list[Bar]:
    """The chain from one of its last pieces on."""
    at, out_end = start, 1 if (start, 1) in taken or (start, 0) not in taken else 0
    chain = [_turned(bars[at], out_end == 0)]
    while (at, out_end) in taken:
        at, into = taken[at, out_end]
        out_end = 1 - into
        chain.append(_turned(bars[at], into == 1))
    return chain


def _turned(bar: Bar, turn: bool) -> Bar:
    return replace(bar, ends=bar.ends[::-1], open=bar.open[::-1]) if turn else bar


def _length_m(chain: list[Bar]) -> float:
    return float(np.linalg.norm(np.diff(_vertices(chain), axis=0), axis=1).sum()) * PIXEL_M


def _vertices(chain: list[Bar]) -> FloatArray:
    """(N, 2) px: the first end, the joints, the last end; a joint lies between the ends that meet there, two ends at a gap."""
    points = [chain[0].ends[0]]
    for one, other in pairwise(chain):
        near = np.hypot(*(other.ends[0] - one.ends[1])) < OVERLAP_PX + 5.0
        points += [(one.ends[1] + other.ends[0]) / 2] if near else [one.ends[1], other.ends[0]]
    return np.array([*points, chain[-1].ends[1]])


@dataclass(frozen=True, slots=True)
class _Whole:
    """Means over a chain's pieces, weighted by their lengths, px."""

    width: float
    sigma: FloatArray
    confidence: float


def _whole(chain: list[Bar]) -> _Whole:
    lengths = np.array([max(bar.length_px, 1.0) for bar in chain])
    width = float(np.average([bar.width_px for bar in chain], weights=lengths))
    sigma = np.average([bar.sigma_px for bar in chain], weights=lengths, axis=0)
    doubt = float(np.prod([1 - confidence(bar) for bar in chain]))
    return _Whole(width, sigma, min(1 - doubt, 0.999))


def _lines(chains: list[list[Bar]], crossings: list[Marking], raster: GroundRaster, settings: MarkingSettings) -> list[Marking]:
    """Dashes, solid lines and stop lines of chains."""
    wholes = [_whole(chain) for chain in chains]
    vertices = [raster.xy(_vertices(chain)) for chain in chains]
    narrow = [xy for xy, whole in zip(vertices, wholes, strict=True) if whole.width * PIXEL_M < settings.stop_width_m]
    segments = np.array([(*(xy[0] + xy[-1]) / 2, *(xy[-1] - xy[0])) for xy in narrow]).reshape(-1, 4)
    along = np.array([_bar_direction(crossing) for crossing in crossings]).reshape(-1, 4)
    segments = np.vstack([segments, along])
    return [_line(chain, xy, whole, segments, raster, settings) for chain, xy, whole in zip(chains, vertices, wholes, strict=True)]


def _bar_direction(crossing: Marking) -> FloatArray:
    """Middle and direction (4,) of a crossing's bars."""
    across = crossing.line[-1, :2] - crossing.line[0, :2]
    d = np.array([-across[1], across[0]]) / max(float(np.hypot(*across)), 1e-9)
    return np.concatenate([crossing.line[:, :2].mean(axis=0), d * crossing.bars * crossing.length_m])


def _line(
    chain: list[Bar], xy: FloatArray, whole: _Whole, segments: FloatArray, raster: GroundRaster, settings: MarkingSettings
) -> Marking:
    """The marking of one chain; segments (K, 4): middles and vectors m of what tells the direction of the traffic."""
    width, length = whole.width * PIXEL_M, float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    kind = "solid" if length >= settings.solid_m else "dash"
    if width >= settings.stop_width_m and length > 3 * width and _is_crosswise(xy, segments):
        kind = "stop_line"
    return Marking(
        kind, lifted(xy, raster), lifted(outline(xy, width), raster), width, length,
        total_sigma(whole.sigma, xy, raster, settings), whole.confidence, (bool(chain[0].open[0]), bool(chain[-1].open[1])),
    )  # fmt: skip


def _is_crosswise(xy: FloatArray, segments: FloatArray) -> bool:
    """Whether a line lies across what goes along the road around it."""
    d, middle = xy[-1] - xy[0], (xy[0] + xy[-1]) / 2
    near = segments[np.hypot(*(segments[:, :2] - middle).T) < NEAR_M]
    if not len(near):
        return False
    angle, weight = np.arctan2(near[:, 3], near[:, 2]), np.hypot(near[:, 2], near[:, 3])
    road = np.arctan2((weight * np.sin(2 * angle)).sum(), (weight * np.cos(2 * angle)).sum()) / 2
    turn = abs((np.arctan2(d[1], d[0]) - road + np.pi / 2) % np.pi - np.pi / 2)
    return bool(turn > CROSSWISE_RAD)
