"""Label metrics from a confusion matrix: IoU, class-wise accuracy, mIoU and overall accuracy.

    IoU_c = TP_c / (TP_c + FP_c + FN_c)      accuracy_c = TP_c / N_c, where N_c points are labelled c      OA = sum TP_c / N

mIoU is the mean over the classes that the truth holds; sky is never among them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_ID, CLASS_NAMES, SKY, VOID

Counts = NDArray[np.int64]
JUDGED: Final = tuple(c for c in range(CLASS_COUNT) if c != SKY)
"""The paper's 18 classes."""
GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "flat": ("road", "sidewalk"),
    "construction": ("building", "wall", "fence"),
    "object": ("pole", "traffic light", "traffic sign"),
    "nature": ("vegetation", "terrain"),
    "human": ("person", "rider"),
    "vehicle": ("car", "truck", "bus", "train", "motorcycle", "bicycle"),
}
"""Cityscapes' groups of classes."""


def count(truth: NDArray[np.uint8], found: NDArray[np.uint8]) -> Counts:
    """(19, 256) how many points of each true class got each label; none where the truth is void. truth, found : (N,) train ids."""
    known = truth != VOID
    pairs = truth[known].astype(np.int64) * 256 + found[known]
    return np.bincount(pairs, minlength=CLASS_COUNT * 256).reshape(CLASS_COUNT, 256)


@dataclass(frozen=True, slots=True)
class LabelScores:
    """All in percent. iou: classes that the truth holds; accuracy: classes that were found; groups: mean IoU of each group."""

    points: int
    miou: float
    oa: float
    iou: dict[str, float]
    accuracy: dict[str, float]
    groups: dict[str, float]

    def as_json(self) -> dict[str, object]:
        """Nested dict of numbers, None for what is not defined."""
        return {
            "miou": _defined(self.miou), "oa": _defined(self.oa), "points": self.points,
            "iou": self.iou, "accuracy": self.accuracy, "groups": self.groups,
        }  # fmt: skip


def scores(counts: Counts) -> LabelScores:
    """The table's row for counts (19, 256) of `count`."""
    hits, of_class = np.diag(counts), counts.sum(axis=1)
    found = counts.sum(axis=0)[:CLASS_COUNT]
    iou = {c: 100.0 * float(hits[c]) / float(of_class[c] + found[c] - hits[c]) for c in JUDGED if of_class[c]}
    accuracy = {CLASS_NAMES[c]: 100.0 * float(hits[c]) / float(found[c]) for c in JUDGED if found[c]}
    groups = {}
    for name, members in GROUPS.items():
        there = [iou[CLASS_ID[member]] for member in members if CLASS_ID[member] in iou]
        if there:
            groups[name] = float(np.mean(there))
    total = int(counts.sum())
    return LabelScores(
        points=total,
        miou=float(np.mean(list(iou.values()))) if iou else float("nan"),
        oa=100.0 * float(hits.sum()) / total if total else float("nan"),
        iou={CLASS_NAMES[c]: value for c, value in iou.items()},
        accuracy=accuracy,
        groups=groups,
    )


def _defined(value: float) -> float | None:
    return value if np.isfinite(value) else None
