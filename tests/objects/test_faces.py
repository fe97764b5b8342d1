"""Pieces of a label that faces are looked for in."""

import cv2
import numpy as np
import pytest

from wayloom.objects.faces import _pieces


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6])
def test_pieces_are_those_of_the_whole_image_in_its_order(share: float) -> None:
    mask = np.zeros((40, 60), bool)
    mask[7:31] = np.random.default_rng(4).random((24, 60)) < share
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    np.testing.assert_array_equal(_pieces(mask), stats[1:])
