"""KITTI-360 label ids: their mapping to Cityscapes train ids, and the label images.

The ids are those of Cityscapes and some of KITTI-360's own. What the published table gives no train id is void: trailers, caravans,
lamps, bins, … An instance number is 1000 times the id plus a number within the class, 0 for what has no instances.
"""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import read_bytes
from wayloom.logs.kitti.kitti_360_layout import Sequence

VOID: Final = 255
NAMES: Final = (
    "unlabeled", "ego vehicle", "rectification border", "out of roi", "static", "dynamic", "ground", "road", "sidewalk", "parking",
    "rail track", "building", "wall", "fence", "guard rail", "bridge", "tunnel", "pole", "polegroup", "traffic light",
    "traffic sign", "vegetation", "terrain", "sky", "person", "rider", "car", "truck", "bus", "caravan", "trailer", "train",
    "motorcycle", "bicycle", "garage", "gate", "stop", "smallpole", "lamp", "trash bin", "vending machine", "box",
    "unknown construction", "unknown vehicle", "unknown object",
)  # fmt: skip
"""Name of each id."""
ID_OF_TRAIN_ID: Final = np.array([7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33], np.uint8)
"""(19,) the id of each of Cityscapes' train ids."""
MERGED: Final = {34: 2, 35: 4, 37: 5}
"""Ids that share another's train id: a garage is a building, a gate a fence, a small pole a pole."""
WITH_INSTANCES: Final = frozenset((11, 17, 19, 20, *range(24, 35), *range(36, 42)))
"""Ids whose things are told apart."""
THINGS_PER_CLASS: Final = 1000


def _train_ids() -> NDArray[np.uint8]:
    table = np.full(256, VOID, np.uint8)
    table[ID_OF_TRAIN_ID] = np.arange(len(ID_OF_TRAIN_ID))
    table[list(MERGED)] = list(MERGED.values())
    return table


TRAIN_ID_OF_ID: Final = _train_ids()
"""(256,) the train id of each id, 255 void."""


def train_ids(ids: NDArray[np.integer]) -> NDArray[np.uint8]:
    """KITTI-360's label ids of any shape to train ids; what is no label id (negative, over 255) is void."""
    known = (ids >= 0) & (ids <= 255)
    return np.where(known, TRAIN_ID_OF_ID[np.where(known, ids, 0)], VOID).astype(np.uint8)


def label_ids(train: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Train ids of any shape to KITTI-360's label ids; void becomes 0, unlabeled."""
    table = np.zeros(256, np.uint8)
    table[: len(ID_OF_TRAIN_ID)] = ID_OF_TRAIN_ID
    return np.asarray(table[train])


def instance_numbers(ids: NDArray[np.uint8], instances: NDArray[np.integer]) -> NDArray[np.int32]:
    """KITTI-360's instance numbers of instances numbered from 1 on, 0 for none. A class has 999, which repeat beyond."""
    has = np.isin(ids, list(WITH_INSTANCES)) & (instances > 0)
    within = np.where(has, 1 + (instances.astype(np.int64) - 1) % (THINGS_PER_CLASS - 1), 0)
    return (ids.astype(np.int64) * THINGS_PER_CLASS + within).astype(np.int32)


def has_labels(sequence: Sequence, frame: int, camera: int = 0) -> bool:
    """Whether the image of a frame is labelled: KITTI-360 labels some."""
    return sequence.label_image("semantic", frame, camera).is_file()


def read_semantic(sequence: Sequence, frame: int, camera: int = 0) -> NDArray[np.uint8]:
    """(h, w) train ids of a frame's image, 255 void; camera 0 is left, 1 right. Raises LogError."""
    return train_ids(_read(sequence.label_image("semantic", frame, camera), np.uint8))


def _read(file: Path, kind: type[np.uint8] | type[np.uint16]) -> NDArray[np.integer]:
    data = read_bytes(file, remedy="KITTI-360 labels some frames only: see has_labels")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None or image.ndim != 2 or image.dtype != kind:
        what = f"is no label image of {np.dtype(kind).itemsize * 8} bits and one channel"
        raise LogError(what, file=file, remedy="copy the file again")
    return np.asarray(image)
