"""The paper's measures, by hand."""

import csv
import io

import numpy as np
import pytest

from wayloom.evaluation.label_scores import count, scores
from wayloom.evaluation.label_tables import as_csv, as_latex, as_text
from wayloom.evaluation.labels import LabelBenchmark

ROAD, BUILDING, SKY, CAR, VOID = 0, 2, 10, 13, 255
TRUTH = np.array([ROAD] * 6 + [BUILDING] * 3 + [CAR], np.uint8)
FOUND = np.array([ROAD] * 5 + [BUILDING] + [BUILDING] * 2 + [SKY] + [CAR], np.uint8)


def test_iou_accuracy_and_overall_accuracy_are_those_of_the_definition() -> None:
    row = scores(count(TRUTH, FOUND))
    assert row.points == 10
    assert row.iou == pytest.approx({"road": 500 / 6, "building": 200 / 4, "car": 100.0})
    assert row.accuracy == pytest.approx({"road": 100.0, "building": 200 / 3, "car": 100.0})
    assert row.miou == pytest.approx((500 / 6 + 50 + 100) / 3)
    assert row.oa == pytest.approx(80.0)
    assert row.groups == pytest.approx({"flat": 500 / 6, "construction": 50.0, "vehicle": 100.0})


def test_points_without_truth_do_not_count_and_a_void_label_is_an_error() -> None:
    row = scores(count(np.array([VOID, ROAD, ROAD], np.uint8), np.array([ROAD, VOID, ROAD], np.uint8)))
    assert row.points == 2
    assert row.oa == 50.0
    assert row.iou == {"road": 50.0}


def test_counts_of_drives_are_pooled_by_adding() -> None:
    whole, parts = count(TRUTH, FOUND), count(TRUTH[:4], FOUND[:4]) + count(TRUTH[4:], FOUND[4:])
    assert np.array_equal(whole, parts)


def test_nothing_to_judge_is_not_defined() -> None:
    row = scores(count(np.zeros(0, np.uint8), np.zeros(0, np.uint8)))
    assert row.as_json()["miou"] is None
    assert row.as_json()["oa"] is None


def test_every_table_holds_the_same_numbers() -> None:
    row = scores(count(TRUTH, FOUND))
    result = LabelBenchmark("net_1", ("one", "two"), {"kept": 10, "sky": 3}, {"baseline": row, "best": row}, {"baseline": row})
    text, latex = as_text(result), as_latex(result)
    assert "83.3" in text
    assert "80.0" in text
    assert "3 sky" in text
    assert "83.3" in latex
    assert "66.7" in text  # accuracy of building; no IoU has this value
    assert "66.7" in latex
    assert r"net\_1" not in latex.splitlines()[1]
    lines = list(csv.DictReader(io.StringIO(as_csv(result))))
    assert len(lines) == 6
    assert (lines[0]["road"], lines[0]["overall accuracy"], lines[0]["terrain"]) == ("83.3", "80.0", "")
    assert (lines[1]["measure"], lines[1]["building"]) == ("accuracy", "66.7")
