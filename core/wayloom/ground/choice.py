"""Choice of the sheet that shows a block: the sharpest of those that the newest one does not contradict, in the best light.

Blocks choose by sums over the blocks around them, so one sheet shows a patch of many metres: two are never averaged, and neither
double edges nor speckles can come of drives that lie a few centimetres apart.

Where two sheets differ in brightness, either the ground is another since the older one came, or the light was: a shadow, a wet
day. The ground's own detail tells: a shadow scales it and lets it stay, ground laid anew has its own. So the signs of the steps
between neighbouring places of 20 cm are compared, which no light changes but across a shadow's edge (rank correlation, as
Kendall's tau: of two sheets' grounds that have nothing to do with each other as many steps agree as do not). If it is the light,
both tell of the ground, and the brighter one shows it.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.balance import box_sum
from wayloom.ground.kernels.detail import step_agreement
from wayloom.ground.kernels.merging import COLOURS, HEIGHT, HEIGHTS, SAMPLES, SEEN, SHARPNESS, SIGMA
from wayloom.ground.levelling import seam_gains

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
PATCH_BLOCKS: Final = 5
CHANGED_SHARE: Final = 0.2
CHANGED_GREY: Final = 8.0
"""The mean colour of a block is another where it differs by this share of the brighter one's and so many grey levels: another
ground, or another light."""
AROUND_BLOCKS: Final = 2
CHANGED_MM: Final = 40.0
SIGMAS: Final = 3.0
LEAST_SAMPLES: Final = SAMPLES * SAMPLES // 2
SAME_GROUND_ONE_IN: Final = 4
"""It is one ground if of the steps around a block so many more agree than do not: one in so many."""
LEAST_STEPS: Final = 150
"""Of 600 around a block: fewer tell nothing."""


@dataclass(frozen=True, slots=True)
class _Dimmer:
    """Where (N, N) the sheet in row `dark` is dimmer than the one in row `lit` and both show one ground; both, where they are on
    one ground at all."""

    dark: int
    lit: int
    dimmer: BoolArray
    both: BoolArray


@dataclass(frozen=True, slots=True)
class Ranking:
    """order (S, N, N): the sheets of each block, best first, of which the first `allowed` (N, N) are to be shown at all; gain
    (S, N, N, 3) of each where it is shown."""

    order: IntArray
    allowed: IntArray
    gain: FloatArray


def ranked_sheets(sums: IntArray, balance: FloatArray, age: IntArray, detail: Callable[[int], NDArray[np.int16]]) -> Ranking:
    """Who shows the blocks of a window.

    sums (S, N, N, 8); balance (S, 4, N, N): the fields of `balance.balance_fields` at blocks
    age (S,) ranks, the newest has the highest
    detail : of a sheet's row the detail (N, N, SAMPLES, SAMPLES) of its blocks (`kernels.detail`), asked where brightness differs
    """
    seen, colour = sums[..., SEEN] >= LEAST_SAMPLES, balanced_colours(sums, balance)
    outdated, dimmer = _compared(sums, balance, colour, age, detail)
    score = box_sum(np.where(outdated, 0, sums[..., SHARPNESS]), PATCH_BLOCKS)
    allowed = ~outdated & ((sums[..., SEEN] > 0) | (sums[..., HEIGHTS] > 0))
    shaded = _shaded(dimmer, outdated)
    ages = np.broadcast_to(age[:, None, None], score.shape)
    order, count = np.lexsort((-ages, -score, shaded, ~allowed), axis=0), allowed.sum(axis=0)
    shown = _first(order, np.take_along_axis(seen, order, axis=0) & (np.arange(len(order))[:, None, None] < count))
    rows, columns = np.indices(shown.shape)
    alike = ~_is_another(colour, colour[shown, rows, columns])
    return Ranking(order, count, seam_gains(colour, seen, alike, shown))


def balanced_colours(sums: IntArray, balance: FloatArray) -> FloatArray:
    """(S, N, N, 3) mean colours of blocks, brought to what all say together."""
    gain = np.moveaxis(balance[:, :3], 1, -1)
    return np.asarray(gain * sums[..., COLOURS] / np.maximum(16.0 * sums[..., SEEN], 1.0)[..., None])


def _compared(
    sums: IntArray, balance: FloatArray, colour: FloatArray, age: IntArray, detail: Callable[[int], NDArray[np.int16]]
) -> tuple[BoolArray, list[_Dimmer]]:
    """(S, N, N): the newest sheet there is newer, and shows another ground or height than this one, here and around; and which
    sheets show one ground in another light."""
    seen, known = sums[..., SEEN] >= LEAST_SAMPLES, sums[..., HEIGHTS] >= LEAST_SAMPLES
    height = sums[..., HEIGHT] / np.maximum(sums[..., HEIGHTS], 1) + balance[:, 3]
    sigma2 = (sums[..., SIGMA] / np.maximum(sums[..., HEIGHTS], 1)) ** 2
    newest_seen, newest_known = _newest(seen, age), _newest(known, age)
    other_ground, dimmer = np.zeros(seen.shape, np.bool_), []
    for s, t in itertools.combinations(range(len(sums)), 2):
        both = seen[s] & seen[t]
        differs = both & _is_another(colour[s], colour[t])
        if not differs.any():
            continue
        one_ground = both & _is_one_ground(detail(s), detail(t))
        older, newer = (s, t) if age[s] < age[t] else (t, s)
        other_ground[older] |= differs & ~one_ground & (newest_seen == newer)
        less = colour[s].sum(axis=-1) < colour[t].sum(axis=-1)
        for dark, lit, darker in ((s, t, less), (t, s, ~less)):
            dimmed = differs & one_ground & darker
            dimmer += [_Dimmer(dark, lit, dimmed, one_ground)] if dimmed.any() else []
    far = np.abs(height - _at(height, newest_known))
    limit = np.maximum(CHANGED_MM, SIGMAS * np.sqrt(sigma2 + _at(sigma2, newest_known)))
    older_seen, older_known = seen & (age[:, None, None] < age[newest_seen]), known & (age[:, None, None] < age[newest_known])
    outdated = (older_seen & _mostly(other_ground, older_seen)) | (older_known & _mostly(far > limit, older_known))
    return outdated, dimmer


def _shaded(dimmer: list[_Dimmer], outdated: BoolArray) -> BoolArray:
    """(S, N, N): another sheet shows the ground in a better light, here and around, or next to here: a shadow has soft edges."""
    shaded = np.zeros(outdated.shape, np.bool_)
    for pair in dimmer:
        both = pair.both & ~outdated[pair.dark] & ~outdated[pair.lit]
        core = both & _mostly(pair.dimmer, both)
        shaded[pair.dark] |= both & (box_sum(core.astype(np.int64), AROUND_BLOCKS) > 0)
    return shaded


def _is_another(one: FloatArray, other: FloatArray) -> BoolArray:
    """(..., N, N) whether colours (..., N, N, 3) differ in any channel."""
    limit = np.maximum(CHANGED_SHARE * np.maximum(one, other), CHANGED_GREY)
    return np.asarray((np.abs(one - other) > limit).any(axis=-1))


def _is_one_ground(one: NDArray[np.int16], other: NDArray[np.int16]) -> BoolArray:
    """(N, N) whether the detail around blocks agrees."""
    counts = np.zeros((2, *one.shape[:2]), np.int64)
    step_agreement(one, other, counts)
    agreed, told = box_sum(counts, AROUND_BLOCKS)
    return np.asarray((told >= LEAST_STEPS) & (SAME_GROUND_ONE_IN * agreed >= told))


def _first(order: IntArray, may_be: BoolArray) -> IntArray:
    """(N, N) the first sheet of the order (S, N, N) that may be, -1 where none may."""
    first = np.take_along_axis(order, np.argmax(may_be, axis=0)[None], axis=0)[0]
    return np.where(may_be.any(axis=0), first, -1)


def _newest(there: BoolArray, age: IntArray) -> IntArray:
    """(N, N) the sheet with the highest age among those that are there (S, N, N); any where none is."""
    return np.asarray(np.argmax(np.where(there, age[:, None, None], -1), axis=0))


def _at(values: FloatArray, sheet: IntArray) -> FloatArray:
    """(N, N, ...) of the sheet of each block."""
    rows, columns = np.indices(sheet.shape)
    return np.asarray(values[sheet, rows, columns])


def _mostly(marked: BoolArray, among: BoolArray) -> BoolArray:
    """(..., N, N): of the blocks around that are `among` most are marked."""
    counted, of_them = (box_sum(one.astype(np.int64), AROUND_BLOCKS) for one in (among, among & marked))
    return np.asarray(2 * of_them > counted)
