"""Exposure control: what it meters, how it follows the light, and what shutter and amplifier each do."""

import numpy as np
import pytest

from wayloom.simulation.sensors.exposure import exposure_of, light_factor, limited, metered, next_factor
from wayloom.simulation.vehicle.vehicle_settings import ExposureSettings, LightChange


def test_metering_looks_where_it_is_told() -> None:
    image = np.full((100, 120, 3), 0.1, np.float32)
    image[:35] = 5.0  # sky
    image[25:75, 40:80] = 0.4
    assert metered(image, ExposureSettings(metering="centre")) == pytest.approx(0.4)
    assert 0.1 < metered(image, ExposureSettings(metering="road")) < 0.2
    assert metered(image, ExposureSettings(metering="mean")) > 0.3


def test_full_compensation_brings_any_scene_to_the_target_in_the_end() -> None:
    settings = ExposureSettings(compensation=1.0, time_constant_s=0.3)
    factor = next_factor(None, 0.17, 0.0, settings)
    for _ in range(60):
        factor = next_factor(factor, 0.05, 0.1, settings)
    assert factor * 0.05 == pytest.approx(settings.target, rel=1e-3)


def test_after_its_time_constant_control_has_gone_all_but_an_eth_of_the_way() -> None:
    settings = ExposureSettings(compensation=1.0, time_constant_s=0.5)
    factor = 1.0
    for _ in range(50):
        factor = next_factor(factor, settings.target / 4, 0.01, settings)
    assert np.log(factor) == pytest.approx(np.log(4) * (1 - np.exp(-1)), rel=1e-6)


def test_the_shutter_opens_first_and_the_amplifier_does_the_rest() -> None:
    settings = ExposureSettings(unit_s=0.004, longest_s=0.008, shortest_s=0.0005, largest_gain=4.0)
    bright, dark, darkest = (exposure_of(f, settings) for f in (0.5, 4.0, 100.0))
    assert (bright.exposure_s, bright.gain) == pytest.approx((0.002, 1.0))
    assert (dark.exposure_s, dark.gain) == pytest.approx((0.008, 2.0))
    assert (darkest.exposure_s, darkest.gain) == (0.008, 4.0)
    for e in (bright, dark, darkest):
        assert e.factor == pytest.approx(e.exposure_s / settings.unit_s * e.gain)
    assert limited(100.0, settings) == pytest.approx(darkest.factor)
    assert limited(1e-3, settings) == pytest.approx(0.125)


def test_light_falls_and_rises_over_its_ramps() -> None:
    change = LightChange(from_s=2.0, to_s=5.0, factor=0.1, ramp_s=0.5)
    assert light_factor((change,), 1.9) == 1.0
    assert light_factor((change,), 2.25) == pytest.approx(np.sqrt(0.1))
    assert light_factor((change,), 3.0) == pytest.approx(0.1)
    assert light_factor((change,), 4.75) == pytest.approx(np.sqrt(0.1))
    assert light_factor((change, change), 3.0) == pytest.approx(0.01)
    assert light_factor((change.model_copy(update={"ramp_s": 0.0}),), 2.0) == pytest.approx(0.1)
