"""Height datums: stretches of GNSS fixes whose heights alone lie apart, by one constant, and whose place is right.

A receiver that changes its base station, its geoid or its kind of fix keeps its place and moves its height. Left out, such fixes
would take their places with them. So a stretch that was left out is given a height of its own (`AntennaFixes.datum`), an unknown
of the graph without a prior, where the odometry denies neither its places nor that its heights differ by a constant: with
e = antenna - fix of its n witnesses and P = R + S their covariance (`wayloom.mapping.linear_beliefs`), chi-square of the 3 n - 1
numbers that remain when the common height is estimated from them,
    e^T P^-1 e - (u^T P^-1 e)^2 / (u^T P^-1 u),   u = (0, 0, 1, 0, 0, 1, ...).
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.fix_witnesses import Witnesses
from wayloom.mapping.linear_beliefs import MOST_TURNED, LinearBeliefs

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def height_datums(
    witnesses: Witnesses, believed: BoolArray, jump: BoolArray, linear: LinearBeliefs, probability: float
) -> IntArray:
    """(B,) for each stretch the number of its height datum: 0 the drive's, or none at all where the stretch stays left out.

    believed : (B,), jump : (M,) whether a fix begins something new, probability : quantile of chi-square that is still believed
    Runs of stretches that are left out are judged whole: one that lies apart in its place too takes its run with it.
    """
    datum, number = np.zeros(len(believed), np.int64), 0
    edges = np.flatnonzero(np.diff(np.concatenate([[True], believed, [True]]).astype(np.int8)))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if all(_differs_in_height(witnesses, stretch, linear, probability) for stretch in range(first, end)):
            begins = jump[witnesses.first[first:end]]
            begins[0] = True
            datum[first:end] = number + np.cumsum(begins)
            number = int(datum[end - 1])
    return datum


def _differs_in_height(witnesses: Witnesses, stretch: int, linear: LinearBeliefs, probability: float) -> bool:
    members = np.flatnonzero(witnesses.stretch == stretch)
    if len(members) < 2 or len(members) > MOST_TURNED:
        return False
    whitened_error, whitened_up = linear.whitened(members, np.tile([0.0, 0.0, 1.0], len(members)))
    along = float(whitened_up @ whitened_error)
    rest = float(whitened_error @ whitened_error) - along**2 / float(whitened_up @ whitened_up)
    return rest <= float(chi_square_quantile(probability, 3 * len(members) - 1))


def datum_heights(residual_enu: FloatArray, datum: IntArray) -> FloatArray:
    """(D,) m by which each datum but the drive's lies higher, of residuals (M, 3) and the datum (M,) of each fix."""
    return np.array([residual_enu[datum == number, 2].mean() for number in range(1, int(datum.max(initial=0)) + 1)])


def without_datums(residual_enu: FloatArray, datum: IntArray, height_m: FloatArray) -> FloatArray:
    """(M, 3) m: residuals (M, 3) less the height (D,) of each one's datum (M,)."""
    out = residual_enu.copy()
    out[:, 2] -= np.append(0.0, height_m)[datum]
    return out
