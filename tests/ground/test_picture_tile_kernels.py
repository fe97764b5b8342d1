"""Kernels of the orthophoto's tiles against plain numpy."""

import numpy as np
import pytest

from wayloom.ground.kernels import picture_tiles

pytestmark = pytest.mark.kernels
RNG = np.random.default_rng(5)


def test_tiles_at_half_their_size_are_means_of_what_shows() -> None:
    tile = RNG.integers(0, 256, (40, 60, 4), np.uint8)
    tile[..., 3] = RNG.choice([0, 0, 64, 255], (40, 60))
    half = np.full((20, 30, 4), 7, np.uint8)
    picture_tiles.halve_colours(tile, half)
    fours = tile.reshape(20, 2, 30, 2, 4).astype(np.float64)
    total = fours[..., 3].sum(axis=(1, 3))
    colour = (fours[..., :3] * fours[..., 3:]).sum(axis=(1, 3)) / np.maximum(total, 1.0)[..., None]
    np.testing.assert_array_equal(half, np.rint(np.concatenate([colour, total[..., None] / 4], axis=2)))


@pytest.mark.parametrize("channels", [1, 3])
def test_of_two_pictures_each_pixel_is_of_the_sharper_one_that_shows(channels: int) -> None:
    alpha = RNG.random((20, 30), np.float32)
    colour = (300 * RNG.random((20, 30, channels), np.float32) - 20) * alpha[..., None]
    sharpness = RNG.integers(0, 4, (20, 30), np.uint8)
    tile, best = RNG.integers(0, 256, (20, 30, 4), np.uint8), RNG.integers(0, 4, (20, 30), np.uint8)
    laid, laid_best = tile.copy(), best.copy()
    picture_tiles.lay_sharper(colour, alpha, sharpness, np.float32(0.5), laid, laid_best)
    better = (alpha >= 0.5) & (sharpness > best)
    shown = np.rint(colour / np.maximum(alpha, np.float32(0.5))[..., None]).clip(0, 255)
    assert better.any()
    np.testing.assert_array_equal(laid[better, :3], np.broadcast_to(shown[better], (better.sum(), 3)))
    np.testing.assert_array_equal(laid[better, 3], 255)
    np.testing.assert_array_equal(laid[~better], tile[~better])
    np.testing.assert_array_equal(laid_best, np.where(better, sharpness, best))
