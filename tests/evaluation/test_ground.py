"""Measures of ground sheets on made rasters."""

import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.evaluation.ground import (
    KERB_AWAY_M,
    KERB_AWAY_WINDOW,
    KERB_WINDOW,
    TrueGround,
    compare,
    kerb_heights,
    scores,
)
from wayloom.ground.sheet import CELL_M, NO_HEIGHT, GroundSheet

ROAD, SIDEWALK = CLASS_ID["road"], CLASS_ID["sidewalk"]


@pytest.fixture
def truth():
    """6 x 8 m, a kerb of 12 cm at x = 4 m; the track along x = 2 m."""
    class_id = np.full((60, 80), ROAD, np.uint8)
    class_id[:, 40:] = SIDEWALK
    distance = np.abs(np.arange(80) * CELL_M - 2.0)[None].repeat(60, axis=0).astype(np.float32)
    return TrueGround(np.zeros(2, np.int64), np.where(class_id == SIDEWALK, 0.12, 0.0), class_id, distance)


def sheet_of(height):
    rows, columns = height.shape
    votes = np.zeros((rows, columns, 3), np.uint16)
    votes[..., 0] = 50
    return GroundSheet(
        "0" * 64, np.eye(4), np.zeros(2, np.int32), np.array([0, 1], np.int64),
        np.where(np.isnan(height), NO_HEIGHT, np.rint(np.nan_to_num(1000 * height))).astype(np.int16),
        np.full(height.shape, 10, np.uint8), votes,
        np.zeros((2 * rows, 2 * columns, 1), np.uint8), np.zeros((2 * rows, 2 * columns), np.uint8),
    )  # fmt: skip


def test_coverage_and_errors_are_those_of_the_cells_that_the_sheet_has(truth):
    height = truth.height + 0.02
    height[:15] = np.nan
    found = scores([compare(sheet_of(height), np.eye(4), truth)], truth)
    assert found.coverage == {ROAD: pytest.approx(0.75), SIDEWALK: pytest.approx(0.75)}
    assert (found.median_m, found.bias_m) == (pytest.approx(0.02), pytest.approx(0.02))
    assert found.normalised_error == pytest.approx(2.0 / np.sqrt(0.4549))
    assert found.iou[ROAD] == pytest.approx(0.5)


def test_a_kerb_that_is_moved_is_wrong_at_the_edge_and_right_away_from_it(truth):
    moved = np.roll(truth.height, -2, axis=1)
    moved[:, -2:] = 0.12
    at = kerb_heights(moved, truth.height, truth.class_id, 0.0, KERB_WINDOW)
    away = kerb_heights(moved, truth.height, truth.class_id, KERB_AWAY_M, KERB_AWAY_WINDOW)
    np.testing.assert_allclose(at[:, 1], 0.12)
    assert np.median(np.abs(at[:, 0] - at[:, 1])) > 0.05
    np.testing.assert_allclose(away[:, 0], 0.12)


def test_the_true_place_of_a_sheet_counts(truth):
    T_enu_sheet = np.eye(4)
    T_enu_sheet[2, 3] = -0.05
    parts = compare(sheet_of(truth.height), T_enu_sheet, truth)
    np.testing.assert_allclose(parts.error_m, -0.05, atol=1e-9)
