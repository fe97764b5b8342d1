"""Numbers that tell how near images come to real ones."""

from pathlib import Path

import numpy as np
import pytest

from wayloom.evaluation.realism import (
    align_rows,
    image_statistics,
    share_of_strong_gradients,
    spectrum_slopes,
    stereo_residuals,
)
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.registry import open_log
from wayloom.odometry.settings import OdometrySettings
from wayloom.simulation.textures.noise import spectral_noise

RIG = StereoRig(PinholeCamera(500.0, 500.0, 255.5, 127.5, 512, 256), (-0.5, 0.0, 0.0))


def textured(seed: int, exponent: float = 1.6, spread: float = 30.0) -> np.ndarray:
    """(256, 512) uint8 image whose power falls as 1 / f^exponent."""
    field = spectral_noise(np.random.default_rng(seed), 512, exponent)[:256]
    return np.clip(120 + spread * field, 0, 255).astype(np.uint8)


def pair(
    seed: int, disparity: int, noise: float, gain: float = 1.0, offset: float = 0.0, exponent: float = 1.6
) -> tuple[np.ndarray, np.ndarray]:
    """A fronto-parallel plane seen by both cameras, each with noise of its own."""
    rng = np.random.default_rng(seed + 100)
    scene = textured(seed, exponent).astype(float)
    right = np.roll(scene, -disparity, axis=1)
    seen = scene + rng.normal(0, noise, scene.shape), gain * right + offset + rng.normal(0, noise, scene.shape)
    return tuple(np.clip(np.rint(x), 0, 255).astype(np.uint8) for x in seen)


@pytest.mark.parametrize("exponent", [2.2, 2.8, 3.4])
def test_the_slope_of_a_spectrum_is_that_of_the_noise_it_was_made_of(exponent: float) -> None:
    images = [textured(seed, exponent) for seed in range(3)]
    whole, high = spectrum_slopes(images)
    assert whole == pytest.approx(-exponent, abs=0.12)
    assert high == pytest.approx(-exponent, abs=0.3)  # rounding to grey levels adds a little white noise


def test_an_image_smaller_than_a_window_has_no_spectrum() -> None:
    with pytest.raises(ValueError, match="256 px"):
        spectrum_slopes([np.zeros((100, 400), np.uint8)])


def test_the_share_of_strong_gradients_counts_slopes_over_seven_grey_levels_a_pixel() -> None:
    ramp = np.zeros((40, 40), np.uint8)
    ramp[:, :20] = (np.arange(20) * 8).astype(np.uint8)
    ramp[:, 20:] = 160
    assert share_of_strong_gradients(ramp) == pytest.approx(19 / 38)
    assert share_of_strong_gradients(np.full((9, 9), 90, np.uint8)) == 0.0


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_the_residual_of_a_perfect_pair_is_its_noise(noise: float) -> None:
    left, right = pair(1, 17, noise)
    density, residuals = stereo_residuals(left, right, OdometrySettings())
    assert density > 0.6
    # |N(0, sqrt 2 noise)| has its median at 0.6745 of its spread; the fit of the disparity takes a part of it.
    assert 0.6 * 0.954 * noise < float(np.median(residuals)) < 1.15 * 0.954 * noise


def test_gain_and_offset_between_left_and_right_do_not_count() -> None:
    plain = float(np.median(stereo_residuals(*pair(2, 9, 2.0), OdometrySettings())[1]))
    changed = float(np.median(stereo_residuals(*pair(2, 9, 2.0, 0.9, 12.0), OdometrySettings())[1]))
    assert changed == pytest.approx(plain, rel=0.15)


def test_a_right_image_that_lies_a_row_off_is_aligned_before_it_is_compared() -> None:
    left, right = pair(3, 12, 0.5, exponent=2.2)
    shifted = np.roll(right, 1, axis=0)
    aligned = align_rows([(left, shifted)], RIG)[0][1]
    inner = np.s_[20:-20, 20:-20]
    before, after = (np.abs(image[inner].astype(int) - right[inner]).mean() for image in (shifted, aligned))
    assert after < 0.3 * before


def test_nothing_can_be_said_of_no_pairs() -> None:
    with pytest.raises(ValueError, match="no pair"):
        image_statistics([], RIG)


@pytest.mark.real_data
def test_a_real_clip_looks_as_it_was_measured(clip_a: Path) -> None:
    log = open_log(clip_a)
    frames = [log.frame(k) for k in range(0, 96, 24)]
    statistics = image_statistics([(frame.left, frame.right) for frame in frames], log.rig)
    assert -3.0 < statistics.slope < -2.4
    assert -3.8 < statistics.high_slope < -3.2
    assert 0.25 < statistics.strong_gradients < 0.36
    assert 0.45 < statistics.stereo_density < 0.7
    assert 3.4 < statistics.residual < 5.4
