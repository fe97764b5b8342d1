"""Class scores of an image: the k likeliest classes of each cell of the network's grid and their quantised -ln p."""

import math
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.segmentation.kernels.scores import best_scores

Bytes = NDArray[np.uint8]

BEST: Final = 4
"""How many classes are kept of each cell by default."""
STEPS_PER_NAT: Final = 32
"""-ln p is kept in steps of 1/32 (3 % of p), up to 255 steps: p = 0.00035 stands for all that is less."""

_HEADER: Final = struct.Struct("<4s5I")
"""What the file begins with: these letters, k, rows and columns of the grid, height and width of what it covers."""
_LETTERS: Final = b"wls1"
_PROBABILITY: Final[NDArray[np.float32]] = np.exp(np.arange(256) / -STEPS_PER_NAT).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Scores:
    """The k likeliest classes of each cell, best first.

    classes          (gh, gw, k) uint8 train ids
    steps            (gh, gw, k) uint8: -ln p in steps of 1/32, 255 for that and all beyond
    covered          (height, width) in pixels of the image that the grid covers: the frame, padded at the bottom and the right
    """

    classes: Bytes
    steps: Bytes
    covered: tuple[int, int]


def rest_steps(scores: Scores) -> NDArray[np.float32]:
    """(gh, gw) -ln p, in steps, of each class that is not among a cell's k best: they share evenly what the best leave over."""
    k = scores.classes.shape[2]
    sure = _PROBABILITY[scores.steps[..., 0]]
    for i in range(1, k):
        sure += _PROBABILITY[scores.steps[..., i]]
    rest = np.maximum(np.float32(1.0) - sure, np.float32(1e-6))
    steps = np.minimum(
        np.log(rest) * np.float32(-STEPS_PER_NAT) + np.float32(STEPS_PER_NAT * math.log(max(CLASS_COUNT - k, 1))), 255
    )
    return np.asarray(np.maximum(steps, scores.steps[..., -1]), np.float32)


def scores_from_logits(logits: NDArray[np.float32], train_ids: Bytes, covered: tuple[int, int], k: int = BEST) -> Scores:
    """The k best of our classes. logits : (gh, gw, C); train_ids : (C,), 255 = void."""
    classes, steps = best_scores(logits, train_ids, CLASS_COUNT, min(k, CLASS_COUNT), STEPS_PER_NAT)
    return Scores(classes, steps, covered)


def encode_scores(scores: Scores) -> bytes:
    """A header, the classes and the steps, a byte each, not compressed (docs/labelling.md says why)."""
    gh, gw, k = scores.classes.shape
    return _HEADER.pack(_LETTERS, k, gh, gw, *scores.covered) + scores.classes.tobytes() + scores.steps.tobytes()


def decode_scores(data: bytes) -> Scores:
    """What `encode_scores` wrote. Raises ValueError for anything else."""
    if len(data) < _HEADER.size:
        raise ValueError("are no scores")
    letters, k, gh, gw, height, width = _HEADER.unpack_from(data)
    if letters != _LETTERS or not 0 < k <= CLASS_COUNT or not height * width or len(data) != _HEADER.size + 2 * k * gh * gw:
        raise ValueError("are no scores, or not whole")
    classes, steps = np.frombuffer(data, np.uint8, offset=_HEADER.size).reshape(2, gh, gw, k).copy()
    if not classes.size or classes.max() >= CLASS_COUNT:
        raise ValueError("are no scores")
    return Scores(classes, steps, (height, width))
