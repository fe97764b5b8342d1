"""Segmentation metrics of a network on labelled photographs: five KITTI frames and the CamVid frames."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.segmentation.network import Network

Image = NDArray[np.uint8]
CITYSCAPES_IDS: Final = (7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33)
"""Cityscapes' label ids of the 19 train classes, in their order."""
CAMVID_CLASSES: Final = {
    0: (10,),
    1: (2, 3),
    2: (5,),
    3: (0,),
    4: (1,),
    5: (8, 9),
    6: (6, 7),
    7: (4,),
    8: (13, 14, 15, 16),
    9: (11,),
    10: (12, 17, 18),
}
"""CamVid's 11 classes from ours: it draws no walls, terrain or lights of their own."""


@dataclass(frozen=True, slots=True)
class ImageScores:
    """Mean IoU over the classes that the truth holds and accuracy, in percent, over `images` images; iou of each such class."""

    images: int
    miou: float
    accuracy: float
    iou: dict[int, float]


def scores_on_kitti(network: Network, folder: Path) -> ImageScores:
    """On `folder`/image and `folder`/label with Cityscapes' label ids. Raises InputError where nothing is there."""
    truth = np.full(256, 255, np.uint8)
    truth[list(CITYSCAPES_IDS)] = np.arange(19)
    return _scores(network, folder, truth, np.arange(256, dtype=np.uint8), 19)


def scores_on_camvid(network: Network, folder: Path) -> ImageScores:
    """On `folder`/image and `folder`/label with CamVid's 11 classes. Raises InputError where nothing is there."""
    truth = np.full(256, 255, np.uint8)
    truth[:11] = np.arange(11)
    found = np.full(256, 255, np.uint8)
    for camvid, ours in CAMVID_CLASSES.items():
        found[list(ours)] = camvid
    return _scores(network, folder, truth, found, 11)


def _scores(network: Network, folder: Path, truth_of: Image, found_of: Image, classes: int) -> ImageScores:
    files = sorted((folder / "image").glob("*.png"))
    if not files:
        raise InputError("no labelled images", file=folder / "image", remedy="name the folder of the recordings")
    confusion = np.zeros((classes, 256), np.int64)
    for file in files:
        image, label = cv2.imread(str(file)), cv2.imread(str(folder / "label" / file.name), cv2.IMREAD_UNCHANGED)
        if image is None or label is None:
            raise InputError("cannot be read, or has no label beside it", file=file, remedy="copy it again")
        truth, found = truth_of[label], found_of[network.labels(np.ascontiguousarray(image[..., ::-1]))]
        pairs = truth.astype(np.int64) * 256 + found
        confusion += np.bincount(pairs[truth != 255], minlength=classes * 256).reshape(classes, 256)
    hits, of_class = np.diag(confusion), confusion.sum(axis=1)
    there = of_class > 0
    iou = 100.0 * hits[there] / (of_class + confusion.sum(axis=0)[:classes] - hits)[there]
    of_classes = dict(zip(np.nonzero(there)[0].tolist(), iou.tolist(), strict=True))
    return ImageScores(len(files), float(iou.mean()), 100.0 * float(hits.sum() / confusion.sum()), of_classes)
