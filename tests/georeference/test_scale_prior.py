"""What is believed of the odometry's scale before the fixes, and what they alone say of it."""

import numpy as np
import pytest

from wayloom.calibration.baseline import ScaleByGnss
from wayloom.georeference.scale_prior import scale_by_gnss, scale_prior
from wayloom.georeference.settings import GeoReferenceSettings

SETTINGS = GeoReferenceSettings()
OWN = {"sigma": 4e-4, "lens_sigma": 3e-4, "own_sigma": 1e-4, "by_lens": [0.1] * 10, "lens": [0.0] * 10, "baseline_ratio": 1.001}
RIG = {"sha256": "a" * 64, "drives": 3}


def test_a_known_rig_narrows_the_prior_and_an_unknown_one_leaves_it() -> None:
    assert scale_prior({}, SETTINGS) == SETTINGS.scale_sigma
    assert scale_prior({"scale": OWN, "rig": None}, SETTINGS) == SETTINGS.scale_sigma
    known = scale_prior({"scale": OWN, "rig": RIG}, SETTINGS)
    assert known == pytest.approx(np.hypot(4e-4, SETTINGS.local_scale_sigma))
    vague = {"scale": OWN | {"sigma": 0.5}, "rig": RIG}
    assert scale_prior(vague, SETTINGS) == SETTINGS.scale_sigma


def test_what_the_fixes_say_is_the_graphs_scale_without_its_prior() -> None:
    rng = np.random.default_rng(0)
    prior, sigma, truth = SETTINGS.scale_sigma, 0.003, 0.01
    measured = truth + sigma * rng.normal()
    posterior = 1.0 / (1.0 / sigma**2 + 1.0 / prior**2)
    report = {"grade": "A", "scale": {"mean": 1.0 + posterior * measured / sigma**2, "sigma": np.sqrt(posterior)}}
    found = scale_by_gnss(report, {"scale": OWN, "rig": None}, SETTINGS)
    assert found is not None
    assert found["ratio"] == pytest.approx(1.0 + measured, abs=1e-9)
    assert found["sigma"] == pytest.approx(sigma)
    assert ScaleByGnss.from_facts(found).baseline_ratio == OWN["baseline_ratio"]


@pytest.mark.parametrize(
    "report",
    [
        {"grade": "C", "scale": {"mean": 1.0, "sigma": 0.001}},
        {"grade": "A", "scale": {"mean": 1.0, "sigma": 0.015}},
        {"grade": "A", "scale": None},
        {"geo_referenced": False},
    ],
    ids=["doubtful", "loose", "one place", "no fixes"],
)
def test_doubtful_or_loose_fixes_say_nothing_of_a_rig(report: dict[str, object]) -> None:
    assert scale_by_gnss(report, {"scale": OWN}, SETTINGS) is None
