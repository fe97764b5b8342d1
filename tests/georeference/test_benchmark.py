"""The geo-reference is as accurate as the committed numbers of benchmarks/georeference.json say."""

import json
from pathlib import Path

import pytest

from wayloom.evaluation.gnss_cases import Case, cases, judge
from wayloom.evaluation.wheel_drive import measure_wheel_drive

COMMITTED = json.loads((Path(__file__).parents[2] / "benchmarks" / "georeference.json").read_text())
ROWS = {row["name"]: row for row in COMMITTED["cases"]}
SLACK = 1.1
"""Equal drives give equal numbers but for the last bits of other processors' arithmetic: a tenth is a change for the worse."""
TESTED = [
    "RTK", "single point", "clock 50 ms late", "clock 80 ms late, straight at 17 m/s", "lever arm not given",
    "last third shifted by 1.5 m", "single point that claims 2 cm", "bursts 2 m, 20 s, wandering", "bursts 0.5 m, 10 s, constant",
]  # fmt: skip


@pytest.mark.parametrize("case", [case for case in cases() if case.name in TESTED], ids=lambda case: case.name)
def test_a_case_is_as_accurate_as_the_committed_table(case: Case) -> None:
    result, row = judge(case, range(1)), ROWS[case.name]
    assert result.worst_rms_m < SLACK * row["worst_rms_m"]
    assert result.ratio < SLACK * row["ratio"]


def test_no_tested_case_is_missing_in_the_table() -> None:
    assert set(TESTED) <= set(ROWS)


@pytest.mark.real_data
def test_street_canyons_leave_the_wheels_within_eight_metres_and_three_sigmas(data_dir: Path) -> None:
    result = measure_wheel_drive(data_dir / "smartloc")
    assert result.fixes_median_m > 25.0
    assert result.median_m < 8.0
    assert result.ratio < 3.0
