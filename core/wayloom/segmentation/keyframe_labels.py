"""Label images of keyframes as the segmentation left them: labels, scores and small grey images by keyframe and side."""

import json
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError, StageError
from wayloom.logs.images import plain_png
from wayloom.logs.images.image_files import PNG_SIGNATURE, check_png
from wayloom.segmentation.scores import Scores, decode_scores

Labels = NDArray[np.uint8]

MODEL_FILE: Final = "model.json"
SIDES: Final = ("left", "right")
SMALL: Final = 2
"""The images are kept, grey, at 1 / SMALL of their size: enough to tell whether a point looks the same in two of them."""


class KeyframeLabels:
    """The label images of a folder that `segment_keyframes` wrote, decoded when asked for; the last few stay in memory."""

    def __init__(self, folder: Path, frames: Sequence[int] | NDArray[np.integer[Any]], held: int = 4) -> None:
        """frames: the frame index of each keyframe row (`Keyframes.frame`); held: how many images stay in memory."""
        self._folder = folder
        self._frames = [int(index) for index in frames]
        self._held = held
        self._cache: OrderedDict[tuple[str, int], Labels] = OrderedDict()
        self._with_scores = (folder / f"{SIDES[0]}_scores").is_dir()
        facts = facts_in(folder)
        self.may_be_void = facts.get("may_be_void") is not False
        self.is_balanced = facts.get("balanced") is True

    def __len__(self) -> int:
        return len(self._frames)

    def left(self, keyframe: int) -> Labels:
        """(h, w) uint8 train ids of the left image of the keyframe in this row. Raises StageError where the file is missing."""
        return self._get("left", keyframe)

    def right(self, keyframe: int) -> Labels:
        """(h, w) uint8 train ids of the right image of the keyframe in this row. Raises StageError where the file is missing."""
        return self._get("right", keyframe)

    def sides(self, keyframe: int) -> tuple[str, ...]:
        """Which images of the keyframe in this row are labelled: "left", and where it votes "right"."""
        return tuple(side for side in SIDES if label_path(self._folder, side, self._frames[keyframe]).is_file())

    def scores(self, side: str, keyframe: int) -> Scores | None:
        """The likeliest classes of the "left" or "right" image of the keyframe in this row; None from a network without scores.

        Raises StageError where the file is missing though the network gives scores.
        """
        if not self._with_scores:
            return None
        path = scores_path(self._folder, side, self._frames[keyframe])
        scores = read_scores(path)
        if scores is None:
            raise StageError(f"{path}: scores missing or damaged; run the segmentation again")
        return scores

    def small(self, side: str, keyframe: int) -> Labels:
        """(h, w) uint8: the "left" or "right" image of the keyframe in this row, grey, at half size (`small_grey`).

        Raises StageError where the file is missing.
        """
        path = small_path(self._folder, side, self._frames[keyframe])
        image = read_small(path)
        if image is None:
            raise StageError(f"{path}: image missing or damaged; run the segmentation again")
        return image

    def _get(self, side: str, keyframe: int) -> Labels:
        key = (side, keyframe)
        if key not in self._cache:
            path = label_path(self._folder, side, self._frames[keyframe])
            labels = read_labels(path)
            if labels is None:
                raise StageError(f"{path}: label image missing or damaged; run the segmentation again")
            self._cache[key] = labels
            if len(self._cache) > self._held:
                self._cache.popitem(last=False)
        self._cache.move_to_end(key)
        return self._cache[key]


def label_path(folder: Path, side: str, frame: int) -> Path:
    """Where the labels of one image lie."""
    return folder / side / f"{frame:010d}.png"


def scores_path(folder: Path, side: str, frame: int) -> Path:
    """Where the scores of one image lie."""
    return folder / f"{side}_scores" / f"{frame:010d}.bin"


def small_path(folder: Path, side: str, frame: int) -> Path:
    """Where the small grey image of one image lies."""
    return folder / f"{side}_small" / f"{frame:010d}.npy"


def facts_in(folder: Path) -> dict[str, Any]:
    """What `model.json` says; nothing where it cannot be read."""
    try:
        facts = json.loads((folder / MODEL_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def read_labels(path: Path) -> Labels | None:
    """The label image (h, w) of a file; None where it is missing or damaged."""
    try:
        data = path.read_bytes()
        plain = plain_png.decode(check_png(data, path), colour=None) if data.startswith(PNG_SIGNATURE) else None
    except (OSError, LogError):
        return None
    image = plain if plain is not None or not data else cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return None if image is None or image.ndim != 2 or image.dtype != np.uint8 else np.asarray(image, np.uint8)


def read_small(path: Path) -> Labels | None:
    """The grey image (h, w) of a file; None where it is missing or damaged."""
    try:
        image = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError):
        return None
    usable = isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype == np.uint8
    return np.asarray(image, np.uint8) if usable else None


def read_scores(path: Path) -> Scores | None:
    """The scores of a file; None where they are missing or damaged."""
    try:
        return decode_scores(path.read_bytes())
    except (OSError, ValueError):
        return None
