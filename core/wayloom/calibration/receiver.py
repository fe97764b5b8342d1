"""Memory of a vehicle's GNSS receiver: time offset and lever arm as its drives tell them, in epochs.

Of x = (tau, lever): tau s by how much the stamps of fixes are too late against the cameras', lever m the antenna in the left
camera's frame. A drive tells a Gaussian without any prior, exp -1/2 [x^T information x - 2 pull^T x]; at one speed tau and the
lever's forward part are hardly told apart, so all four stay together.

Real odometry errs in more ways than its model: MISFIT times a drive's sigma is what chance and that explain (decision 26 believes
an offset from eight sigmas of the model on, which are three of these).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.epochs import Epoch, split

FloatArray = NDArray[np.float64]
STATES: Final = 4
DENIED_SIGMAS: Final = 3.0
MISFIT: Final = 8.0 / DENIED_SIGMAS
"""Real over modelled sigma of what a drive tells."""
CHANGED_CHI_SQUARE: Final = 18.5
"""Of four degrees of freedom, exceeded once in a thousand, with covariances that hold MISFIT."""
LEVER_CHI_SQUARE: Final = 14.16
"""Of three degrees of freedom, exceeded as often as DENIED_SIGMAS is of one."""
UNTOLD: Final = np.array([1.0, 10.0, 10.0, 10.0])
"""Sigmas, s and m, where nothing is known at all."""
BETWEEN_DRIVES: Final = np.array([1e-3, 2e-3, 2e-3, 2e-3])
"""By how much clock, s, and lever arm, m, may differ from drive to drive of an unchanged receiver."""
TOLD_S: Final = 0.025
"""Sigma of the time offset up to which a drive tells it: half of what is believed of an unknown one."""


@dataclass(frozen=True, slots=True)
class ReceiverEvidence:
    """What one drive tells of the receiver.

    drive_id       names it
    t_ns           when it was recorded
    information    (4, 4), pull (4,): see the module's docstring, as the model of the drive's graph has it
    """

    drive_id: str
    t_ns: int
    information: FloatArray
    pull: FloatArray

    @classmethod
    def from_facts(cls, drive_id: str, t_ns: int, facts: Mapping[str, Any]) -> "ReceiverEvidence":
        """As JSON keeps it: `information`, four rows of four, and `pull`."""
        return cls(drive_id, t_ns, np.array(facts["information"], float), np.array(facts["pull"], float))


@dataclass(frozen=True, slots=True)
class LearntReceiver:
    """What an epoch's drives tell of the receiver: mean (4,) of tau s and lever m, covariance (4, 4)."""

    mean: FloatArray
    covariance: FloatArray
    epoch: Epoch[ReceiverEvidence]


def estimate(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and real covariance (4, 4) of what is told by information (4, 4) and pull (4,); wide where nothing is."""
    covariance = np.linalg.inv(information / MISFIT**2 + np.diag(UNTOLD**-2.0))
    return covariance @ pull / MISFIT**2, np.asarray(0.5 * (covariance + covariance.T))


def tells(information: FloatArray) -> bool:
    """Whether a drive of information (4, 4) tells the clock where the lever arm is known."""
    return bool(np.sqrt(information[0, 0]) * TOLD_S > MISFIT)


def split_receiver_epochs(evidence: Sequence[ReceiverEvidence]) -> list[Epoch[ReceiverEvidence]]:
    """The epochs between which clock or antenna changed, by time."""
    return split(evidence, contradiction, CHANGED_CHI_SQUARE)


def contradiction(one: ReceiverEvidence, epoch: Epoch[ReceiverEvidence]) -> float:
    """Chi-square of four degrees of freedom of what a drive tells against what an epoch's drives do."""
    own, told = estimate(one.information, one.pull)
    known = learnt_of(epoch)
    return _cost(own - known.mean, told, known.covariance)


def learnt_of(epoch: Epoch[ReceiverEvidence]) -> LearntReceiver:
    """Mean and covariance of an epoch, with what may differ between drives."""
    information = np.sum([one.information for one in epoch.drives], axis=0)
    mean, covariance = estimate(information, np.sum([one.pull for one in epoch.drives], axis=0))
    covariance = _scatter(epoch.drives, mean) * covariance + np.diag(BETWEEN_DRIVES**2)
    return LearntReceiver(mean, covariance, epoch)


def learnt_receiver(evidence: Sequence[ReceiverEvidence], t_ns: int | None = None) -> LearntReceiver | None:
    """What is known of the receiver for a drive recorded at t_ns: of the epoch that had begun then, or else of the first one; of
    the newest epoch where t_ns is None. None where no drive told anything."""
    epochs = [epoch for epoch in split_receiver_epochs(evidence) if not epoch.stray]
    if not epochs:
        return None
    begun = [epoch for epoch in epochs if t_ns is None or epoch.from_ns <= t_ns]
    return learnt_of(begun[-1] if begun else epochs[0])


def begins_epoch(evidence: Sequence[ReceiverEvidence], drive_id: str) -> bool:
    """Whether a drive is the first one after a change of clock or antenna."""
    return any(epoch.drives[0].drive_id == drive_id and epoch.chi_square is not None for epoch in split_receiver_epochs(evidence))


def receiver_facts(evidence: Sequence[ReceiverEvidence]) -> list[dict[str, Any]]:
    """JSON-ready, epoch by epoch: from when on, of which drives, clock and lever arm with sigmas, and what the first one denies."""
    out = []
    for epoch in split_receiver_epochs(evidence):
        found = learnt_of(epoch)
        sigma = np.sqrt(np.diag(found.covariance))
        out.append({
            "from_time": 1e-9 * epoch.from_ns, "drives": list(epoch.ids), "chi_square": epoch.chi_square, "stray": epoch.stray,
            "time_offset_s": float(found.mean[0]), "sigma_time_offset_s": float(sigma[0]),
            "p_cam_gnss_m": found.mean[1:].tolist(), "sigma_p_cam_gnss_m": sigma[1:].tolist(),
        })  # fmt: skip
    return out


def fused(mean: FloatArray, covariance: FloatArray, learnt: LearntReceiver) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) of a prior and what drives told."""
    gain = np.linalg.solve(covariance + learnt.covariance, covariance).T
    after = covariance - gain @ covariance
    return mean + gain @ (learnt.mean - mean), np.asarray(0.5 * (after + after.T))


def denied(difference: FloatArray, told: FloatArray, known: FloatArray) -> tuple[bool, bool]:
    """Whether what drives tell denies what is known of the clock, and of the lever arm: by the likelihood ratio of letting it go.

    difference : (4,) of the two; told, known : (4, 4) their covariances
    Along the road a late clock and an antenna that sits further back are nearly one: what explains more goes first.
    """
    free = (False, False)
    for _ in range(2):
        cost = _cost(difference, told, loosened(known, free, UNTOLD))
        shares = []
        for part, price in enumerate((DENIED_SIGMAS**2, LEVER_CHI_SQUARE)):
            freed = (free[0] or part == 0, free[1] or part == 1)
            shares.append((cost - _cost(difference, told, loosened(known, freed, UNTOLD))) / price)
        if max(shares) <= 1.0:
            break
        best = int(np.argmax(shares))
        free = (free[0] or best == 0, free[1] or best == 1)
    return free


def loosened(known: FloatArray, free: tuple[bool, bool], sigmas: FloatArray) -> FloatArray:
    """A covariance (4, 4) in which clock, lever arm or both are let go: independent, with these sigmas (4,)."""
    out = known.copy()
    for rows, is_free in ((slice(0, 1), free[0]), (slice(1, STATES), free[1])):
        if is_free:
            out[rows, :] = out[:, rows] = 0.0
            out[rows, rows] = np.diag(sigmas[rows] ** 2)
    return out


def _cost(difference: FloatArray, told: FloatArray, known: FloatArray) -> float:
    return float(difference @ np.linalg.solve(told + known, difference))


def _scatter(drives: Sequence[ReceiverEvidence], mean: FloatArray) -> float:
    """How many times drives scatter about their mean (4,) in square more than they say, 1 at least (Birge's ratio): a clock that is
    set anew with every start is not known better for many drives."""
    if len(drives) < 2:
        return 1.0
    told = [estimate(one.information, one.pull) for one in drives]
    squares = [_cost(x - mean, covariance, np.diag(BETWEEN_DRIVES**2)) for x, covariance in told]
    return max(1.0, float(np.sum(squares)) / (len(told) - 1))
