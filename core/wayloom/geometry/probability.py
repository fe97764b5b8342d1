"""Quantiles and tails of distributions, as of `scipy.stats`, whose import alone takes a second of each process."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betainc, gammaincinv


def chi_square_quantile(probability: float, freedom: ArrayLike) -> NDArray[np.float64]:
    """What a chi-square of so many degrees of freedom, any shape, stays below with this probability; NaN of none."""
    half = np.asarray(freedom, np.float64) / 2
    found: NDArray[np.float64] = np.where(half > 0, 2 * gammaincinv(half, probability), np.nan)
    return found


def log_binomial_tail(at_least: int, count: int, chance: float) -> float:
    """Natural logarithm of the probability that of `count` trials, each with this chance, so many or more succeed; -inf below what
    a float holds."""
    if at_least <= 0:
        return 0.0
    with np.errstate(divide="ignore"):
        return float(np.log(betainc(at_least, count - at_least + 1, chance)))
