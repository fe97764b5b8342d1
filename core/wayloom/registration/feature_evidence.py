"""Evidence of matched local features alone: a-contrario number of false alarms, and the information they have of the pose.

By chance each of n distinct matched things agrees with a pose independently, with probability p. That k or more do, with any of R
poses that are tried, is expected
    NFA = R P(X >= k), X ~ Bin(n, p)
times (Moisan and Stival, IJCV 2004, eq. 6). Features are not independent where a facade repeats itself: many agree with a pose that
is a window off. So p is measured in the pair itself: it is the share that agrees with the best pose of those that are left over.
A count says nothing of where the features are; how well they know the pose does.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import log_binomial_tail
from wayloom.registration.matches import GATE2, ROUNDS, SIGMA_PX, Matches, equations, errors2, pose_of_matches

FloatArray = NDArray[np.float64]
THING_M: Final = 1.0
"""Matches nearer to each other are of one thing: it is seen from several keyframes, and has several corners."""
DEPTH_SIGMAS: Final = 3.0
LEAST_CHANCE: Final = 0.05
"""Chance of a match to agree, at least. In pairs of different places a pose that was sought has 3 % of the things, the median."""
SHARED_ERROR: Final = 4.0
"""Matches that share one error: each feature is seen from several keyframes."""
NO_POSE_M: Final = 99.0


def feature_evidence(a: Matches, b: Matches, T_a_b: FloatArray) -> dict[str, float]:
    """What matches say for a pose T_a_b (4, 4), JSON-ready.

    things         distinct things that agree
    chance_log10   of the number of false alarms
    feature_sigma_m, feature_sigma_deg   the largest standard deviation of place and of attitude by the features alone
    """
    agree = errors2(T_a_b, a, b, SIGMA_PX) < GATE2
    every, good = things(a), things(a.take(agree))
    place, attitude = _sigmas(equations(T_a_b, a, b, SIGMA_PX)[0] / SHARED_ERROR)
    chance = max(LEAST_CHANCE, _left_over(a, b, agree) / max(every, 1))
    return {
        "things": good,
        "chance_log10": float(round(chance_log10(good, every, chance), 1)),
        "feature_sigma_m": round(place, 4),
        "feature_sigma_deg": round(float(np.rad2deg(attitude)), 3),
    }


def chance_log10(agreeing: int, count: int, chance: float) -> float:
    """log10 of the number of false alarms; the poses tried are those of the matches' RANSAC. Never below -300."""
    log10 = log_binomial_tail(agreeing, count, min(chance, 1.0)) / np.log(10.0)
    return float(max(np.log10(ROUNDS) + log10, -300.0))


def things(matches: Matches) -> int:
    """How many distinct things a side's points are of: of those within THING_M of each other, and along the ray within what their
    depths leave open, one counts."""
    p, depth_sigma = matches.p_level, matches.depth_sigma()
    sigma = np.linalg.norm(depth_sigma, axis=1)
    ray = depth_sigma / np.maximum(sigma, 1e-9)[:, None]
    chosen: list[int] = []
    for k in np.argsort(sigma, kind="stable").tolist():
        apart = p[chosen] - p[k]
        along = apart @ ray[k]
        across = np.linalg.norm(apart - along[:, None] * ray[k], axis=1)
        if not ((across < THING_M) & (np.abs(along) < THING_M + DEPTH_SIGMAS * np.hypot(sigma[k], sigma[chosen]))).any():
            chosen.append(k)
    return len(chosen)


def _left_over(a: Matches, b: Matches, agree: NDArray[np.bool_]) -> int:
    """Things that agree with the best pose of the matches that do not."""
    rest_a, rest_b = a.take(~agree), b.take(~agree)
    rival = pose_of_matches(rest_a, rest_b)
    return things(rest_a.take(errors2(rival[0], rest_a, rest_b, SIGMA_PX) < GATE2)) if rival is not None else 0


def _sigmas(information: FloatArray) -> tuple[float, float]:
    """Largest standard deviation of place in m and of attitude in rad; NO_POSE_M and pi where the features leave one open."""
    if np.linalg.cond(information) > 1e12:
        return NO_POSE_M, float(np.pi)
    covariance = np.linalg.inv(information)
    return tuple(float(np.sqrt(np.linalg.eigvalsh(covariance[part, part])[-1])) for part in (slice(3), slice(3, 6)))  # type: ignore[return-value]
