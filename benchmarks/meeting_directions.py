"""Errors of pairs of views by how the two drives look at the place: along the first one's view, across it and up, in sigmas."""

from dataclasses import dataclass

import numpy as np

from wayloom.geometry import se3
from wayloom.loops.priors import Closure

COLUMNS = (
    "the second looks", "pairs", "in the 95 % band", "along: mean, rms cm", "rms in sigmas", "across: rms cm", "in sigmas",
    "up: rms cm", "in sigmas",
)  # fmt: skip
HEAD = f"| {' | '.join(COLUMNS)} |\n|{' --- |' * len(COLUMNS)}"
DIRECTIONS = (("the same way", 0.0, 60.0), ("across", 60.0, 120.0), ("the opposite way", 120.0, 180.1))
BAND = 12.59
"""Chi-square of 6 degrees of freedom, 95 %."""


@dataclass(frozen=True)
class PairError:
    """turn_deg between the two cameras' axes; place (3,) m by how much the second camera lies elsewhere, in the first's axes, and
    its sigma (3,); chi2 of all six."""

    turn_deg: float
    place: np.ndarray
    sigma: np.ndarray
    chi2: float


def error_of(pair: Closure, T_enu_first: np.ndarray, T_enu_second: np.ndarray) -> PairError:
    """Of a pair of keyframes at their true poses."""
    truth, T = se3.inverse(T_enu_first) @ T_enu_second, pair.T_first_second
    xi = se3.log(truth @ se3.inverse(T))
    Ad = se3.adjoint(se3.from_rotation_translation(np.eye(3), -T[:3, 3]))
    sigma = np.sqrt(np.diag(Ad @ pair.covariance @ Ad.T)[:3])
    turn = float(np.degrees(np.arccos(np.clip(truth[2, 2], -1.0, 1.0))))
    return PairError(turn, T[:3, 3] - truth[:3, 3], sigma, float(xi @ np.linalg.solve(pair.covariance, xi)))


def direction_table(errors: list[PairError]) -> str:
    """A row for each way of looking that occurs."""
    rows = [HEAD]
    for name, least, most in DIRECTIONS:
        of = [one for one in errors if least <= one.turn_deg < most]
        if of:
            rows.append(row(name, of))
    return "\n".join(rows)


def row(name: str, errors: list[PairError]) -> str:
    place, sigma = (np.array([getattr(one, part) for one in errors]) for part in ("place", "sigma"))
    cm, ratio = 100.0 * np.sqrt((place**2).mean(axis=0)), np.sqrt(((place / sigma) ** 2).mean(axis=0))
    band = np.mean([one.chi2 < BAND for one in errors])
    along = f"{100.0 * place[:, 2].mean():.1f}, {cm[2]:.1f} | {ratio[2]:.2f}"
    return f"| {name} | {len(errors)} | {band:.0%} | {along} | {cm[0]:.1f} | {ratio[0]:.2f} | {cm[1]:.1f} | {ratio[1]:.2f} |"
