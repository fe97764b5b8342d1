"""Choice of the sheet that shows a block: the sharpest of those that the newest one does not contradict.

Blocks choose by sums over the blocks around them, so one sheet shows a patch of many metres: two are never averaged, and neither
double edges nor speckles can come of drives that lie a few centimetres apart or saw other light.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.balance import at_blocks, box_sum
from wayloom.ground.kernels.merging import COLOURS, HEIGHT, HEIGHTS, SAMPLES, SEEN, SHARPNESS, SIGMA

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


def outdated_blocks(sums: IntArray, fields: FloatArray, age: IntArray) -> BoolArray:
    """(S, N, N): the newest sheet there is newer, and shows another colour or height than this one, here and around.

    sums (S, N, N, 8); fields (S, 4, n, n) of `balance.balance_fields`; age (S,) ranks, the newest has the highest
    """
    seen, known = sums[..., SEEN] >= LEAST_SAMPLES, sums[..., HEIGHTS] >= LEAST_SAMPLES
    balance = at_blocks(fields)
    gain = np.moveaxis(balance[:, :3], 1, -1)
    colour = gain * sums[..., COLOURS] / np.maximum(16.0 * sums[..., SEEN], 1.0)[..., None]
    height = sums[..., HEIGHT] / np.maximum(sums[..., HEIGHTS], 1) + balance[:, 3]
    sigma2 = (sums[..., SIGMA] / np.maximum(sums[..., HEIGHTS], 1)) ** 2
    newest_seen, newest_known = _newest(seen, age), _newest(known, age)
    newest_colour = _at(colour, newest_seen)
    off = np.abs(colour - newest_colour) - np.maximum(CHANGED_SHARE * np.maximum(colour, newest_colour), CHANGED_GREY)
    far = np.abs(height - _at(height, newest_known))
    limit = np.maximum(CHANGED_MM, SIGMAS * np.sqrt(sigma2 + _at(sigma2, newest_known)))
    return _here_and_around(seen, age, newest_seen, off.max(axis=-1) > 0.0) | _here_and_around(
        known, age, newest_known, far > limit
    )


def order_of_sheets(sums: IntArray, outdated: BoolArray, age: IntArray) -> tuple[IntArray, IntArray]:
    """order (S, N, N): the sheets of each block, best first; how many (N, N) of them are to be shown at all."""
    score = box_sum(np.where(outdated, 0, sums[..., SHARPNESS]), PATCH_BLOCKS)
    allowed = ~outdated & ((sums[..., SEEN] > 0) | (sums[..., HEIGHTS] > 0))
    ages = np.broadcast_to(age[:, None, None], score.shape)
    order = np.lexsort((-ages, -score, ~allowed), axis=0)
    return order, allowed.sum(axis=0)


def _newest(there: BoolArray, age: IntArray) -> IntArray:
    """(N, N) the sheet with the highest age among those that are there (S, N, N); any where none is."""
    return np.asarray(np.argmax(np.where(there, age[:, None, None], -1), axis=0))


def _at(values: FloatArray, sheet: IntArray) -> FloatArray:
    """(N, N, ...) of the sheet of each block."""
    rows, columns = np.indices(sheet.shape)
    return np.asarray(values[sheet, rows, columns])


def _here_and_around(there: BoolArray, age: IntArray, newest: IntArray, differs: BoolArray) -> BoolArray:
    """(S, N, N): both are there, and differ in most of the blocks around in which both are. The newest differs from nobody."""
    both = there & (age[:, None, None] < age[newest])
    counted, changed = (box_sum(one.astype(np.int64), AROUND_BLOCKS) for one in (both, both & differs))
    return both & (2 * changed > counted)
