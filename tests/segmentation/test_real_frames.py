"""DeepLab-slim on labelled frames of real streets: the tiles are cut as it needs them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.segmentation.catalogue import MODELS
from wayloom.segmentation.network import Network

# Cityscapes' label ids of the 19 train classes, in their order.
LABEL_IDS = (7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33)
# CamVid's 11 classes from ours; it draws no walls, terrain, lights.
CAMVID = {0: [10], 1: [2, 3], 2: [5], 3: [0], 4: [1], 5: [8, 9], 6: [6, 7], 7: [4], 8: [13, 14, 15, 16], 9: [11], 10: [12, 17, 18]}


@pytest.fixture(scope="module")
def deeplab(models_dir: Path) -> Network:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WAYLOOM_MODELS", str(models_dir))
        return Network(MODELS["deeplab-slim"])


def accuracy(network: Network, images: list[Path], table: np.ndarray, own: np.ndarray) -> float:
    hits = known = 0
    for path in images:
        labels = own[network.labels(cv2.imread(str(path))[..., ::-1])]
        truth = table[cv2.imread(str(path.parents[1] / "label" / path.name), cv2.IMREAD_UNCHANGED)]
        hits += int(((labels == truth) & (truth != 255)).sum())
        known += int((truth != 255).sum())
    return hits / known


@pytest.mark.real_data
@pytest.mark.models
def test_deeplab_slim_is_as_good_on_kitti_frames_as_published_networks_of_its_size(deeplab: Network, data_dir: Path) -> None:
    train_id = np.full(256, 255, np.uint8)
    train_id[list(LABEL_IDS)] = np.arange(19)
    images = sorted((data_dir / "labelled" / "kitti" / "image").glob("*.png"))
    assert len(images) == 5
    assert accuracy(deeplab, images, train_id, np.arange(256, dtype=np.uint8)) >= 0.83


@pytest.mark.real_data
@pytest.mark.models
def test_deeplab_slim_labels_camvid_frames(deeplab: Network, data_dir: Path) -> None:
    table = np.where(np.arange(256) < 11, np.arange(256), 255).astype(np.uint8)
    own = np.full(256, 254, np.uint8)
    for camvid, ours in CAMVID.items():
        own[ours] = camvid
    images = sorted((data_dir / "labelled" / "camvid" / "image").glob("*.png"))
    assert len(images) == 39
    assert accuracy(deeplab, images[::3], table, own) >= 0.80
