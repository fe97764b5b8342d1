"""The few likeliest classes of every cell of a network's grid, in a byte each: what is kept of a softmax."""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.segmentation.kernels.scores import best_scores

Bytes = NDArray[np.uint8]

BEST: Final = 4
"""How many classes are kept of each cell by default."""
STEPS_PER_NAT: Final = 32
"""-ln p is kept in steps of 1/32 (3 % of p), up to 255 steps: p = 0.00035 stands for all that is less."""

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

    @property
    def probabilities(self) -> NDArray[np.float32]:
        """(gh, gw, k) probabilities of `classes`."""
        return _PROBABILITY[self.steps]


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
    """A grey PNG: from the top k planes of classes, k planes of steps, and a row with k, gw, height and width as uint32.

    It is not compressed: that would halve it, and its reading would cost more than the votes themselves.
    """
    gh, gw, k = scores.classes.shape
    planes = np.concatenate([scores.classes.transpose(2, 0, 1), scores.steps.transpose(2, 0, 1)]).reshape(2 * k * gh, gw)
    header = np.array([k, gw, *scores.covered], "<u4").view(np.uint8)
    last = np.zeros((1, max(gw, len(header))), np.uint8)
    last[0, : len(header)] = header
    picture = np.vstack([np.pad(planes, ((0, 0), (0, last.shape[1] - gw))), last])
    written, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    if not written:
        raise ValueError("the scores could not be encoded")
    return data.tobytes()


def decode_scores(data: bytes) -> Scores:
    """What `encode_scores` wrote. Raises ValueError for anything else."""
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    picture = np.asarray(decoded, np.uint8) if decoded is not None and decoded.dtype == np.uint8 else None
    if picture is None or picture.ndim != 2 or picture.shape[1] < 16:
        raise ValueError("is no picture of scores")
    k, gw, height, width = (int(n) for n in picture[-1, :16].copy().view("<u4"))
    rows = picture.shape[0] - 1
    if not 0 < k <= CLASS_COUNT or not 0 < gw <= picture.shape[1] or not rows or rows % (2 * k) or not height or not width:
        raise ValueError("is no picture of scores")
    planes = picture[:-1, :gw].reshape(2, k, rows // (2 * k), gw)
    classes, steps = (np.ascontiguousarray(half.transpose(1, 2, 0)) for half in planes)
    if classes.max() >= CLASS_COUNT:
        raise ValueError("is no picture of scores")
    return Scores(classes, steps, (height, width))
