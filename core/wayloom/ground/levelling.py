"""Seam levelling: gains that let the patches of the merged orthophoto meet without a step.

Fields over tens of metres (`balance`) cannot follow each shadow's half-light, so where one sheet ends to be shown and another
begins, the two may still differ. With L_k the logarithm of the mean colour of sheet k in a block, and b' the blocks around b
where k and the sheet that is shown there both saw the ground in the same light,

    log g_k(b) = sum_b' w (L_shown(b')(b') - L_k(b')) / sum_b' w.

On both sides of a border the windows are the same, so that the two gains differ by what the sheets differ by, and meet in
between; deep inside a patch its own sheet is shown all around, and the gain is one (as the membranes of Perez et al., "Poisson
image editing", SIGGRAPH 2003, but over no more than `REACH_BLOCKS`). All is counted in whole numbers.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.balance import GAIN_DECIMALS, LOG_STEPS, box_sum

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
BOX_BLOCKS: Final = 2
REACH_BLOCKS: Final = 2 * BOX_BLOCKS
"""Boxes summed twice: weights fall to nothing over 4 m."""


def seam_gains(colour: FloatArray, seen: BoolArray, alike: BoolArray, shown: IntArray) -> FloatArray:
    """(S, N, N, 3) gains of each sheet at the middles of blocks.

    colour (S, N, N, 3) balanced mean colours; seen (S, N, N) where they are known
    shown  (N, N) the sheet that shows a block, -1 where none does; alike (S, N, N) whether it has about a sheet's own brightness
    """
    logs = np.rint(LOG_STEPS * np.log(np.maximum(colour, 1.0))).astype(np.int64)
    rows, columns = np.indices(shown.shape)
    of_shown = logs[shown, rows, columns]
    counted = seen & alike & (shown >= 0)
    total = _spread(counted.astype(np.int64))
    difference = np.moveaxis((of_shown - logs) * counted[..., None], -1, 1)
    mean = np.moveaxis(_spread(difference), 1, -1) / np.maximum(total, 1)[..., None]
    return np.asarray(np.round(np.exp(mean / LOG_STEPS), GAIN_DECIMALS))


def _spread(values: IntArray) -> IntArray:
    return box_sum(box_sum(values, BOX_BLOCKS), BOX_BLOCKS)
