"""Overlays of labels on images."""

import numpy as np
import pytest

from wayloom.config.classes import PALETTE_WITH_VOID, VOID
from wayloom.segmentation.overlay import overlay


@pytest.mark.parametrize("alpha", [0.5, 0.3])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_each_class_is_blended_in_its_colour_and_void_stays(channels: tuple[int, ...], alpha: float) -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (30, 40, *channels), np.uint8)
    labels = rng.choice([*range(19), VOID], (30, 40)).astype(np.uint8)
    rgb = np.repeat(image[:, :, None], 3, axis=2) if image.ndim == 2 else image
    share = np.where(labels == VOID, 0.0, alpha).astype(np.float32)[..., None]
    expected = np.rint(rgb + share * (PALETTE_WITH_VOID[labels].astype(np.float32) - rgb)).astype(np.uint8)
    found = overlay(image, labels, alpha)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found[labels == VOID], rgb[labels == VOID])
