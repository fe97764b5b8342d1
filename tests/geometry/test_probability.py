"""Quantiles and tails agree with scipy.stats, to the bit where the map's numbers hang on them."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import binom, chi2

from wayloom.geometry.probability import chi_square_quantile, log_binomial_tail


@pytest.mark.parametrize("probability", [0.001, 0.5, 0.95, 0.999, 1 - 1e-6])
def test_quantiles_are_scipys_bit_by_bit(probability: float) -> None:
    freedom = np.array([0, 1, 2, 3, 6, 9, 300, 5999])
    assert np.array_equal(chi_square_quantile(probability, freedom), chi2.ppf(probability, freedom), equal_nan=True)
    assert float(chi_square_quantile(probability, 6)) == float(chi2.ppf(probability, 6))


@pytest.mark.parametrize("count", [1, 2, 5, 20, 1000])
def test_tails_are_scipys_to_rounding(count: int) -> None:
    for at_least in range(0, count + 1, max(1, count // 10)):
        for chance in (1e-6, 0.001, 0.1, 0.5, 0.9, 1.0):
            with np.errstate(divide="ignore"):
                theirs = binom.logsf(at_least - 1, count, chance)
            assert log_binomial_tail(at_least, count, chance) == pytest.approx(theirs, rel=1e-9, abs=1e-12)


def test_no_stage_imports_scipys_statistics() -> None:
    rooms = "mapping.drive_equations, wayloom.georeference.alignment, wayloom.registration.search, wayloom.stitching.city_graph"
    code = f"import sys, wayloom.{rooms}, wayloom.pipeline.drive; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
