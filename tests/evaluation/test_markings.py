"""Scores of markings and kerbs: what is found is held against what is true, place by place."""

import numpy as np
import pytest

from wayloom.evaluation.markings import Scores, score_kerbs, score_markings
from wayloom.ground.markings.geometry import band
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.markings.types import Kerb, Marking
from wayloom.simulation.city.markings import TrueKerb, TrueMarking

T = np.eye(4)
SETTINGS = MarkingSettings()


def raster() -> GroundRaster:
    """10 x 20 m of ground, all of it seen at 9 pixels a metre."""
    cells, pixels = (100, 200), (200, 400)
    return GroundRaster(
        np.zeros(2), np.zeros(cells), np.full(cells, 0.01), np.zeros(cells, np.uint8), np.full(pixels, 80.0, np.float32),
        np.full(pixels, 9, np.uint8),
    )  # fmt: skip


def line(y: float, first: float = 2.0, last: float = 5.0) -> np.ndarray:
    return np.array([(first, y, 0.0), (last, y, 0.0)])


def found(y: float, width: float = 0.15) -> Marking:
    return Marking("dash", line(y), band(line(y), width), width, 3.0, np.array([0.03, 0.05, 0.02]), 0.9)


def true(y: float) -> TrueMarking:
    return TrueMarking("dash", line(y), band(line(y), 0.13), 0.13, 3.0)


def scored(dash: Marking) -> Scores:
    scores = Scores()
    score_markings(scores, [dash], [true(5.0)], raster(), T, SETTINGS)
    return scores


def test_a_dash_three_centimetres_aside_is_true_and_so_far_off() -> None:
    scores = scored(found(5.03))
    assert (scores.true, scores.hit["dash"]) == (pytest.approx(scores.found), pytest.approx(scores.seen["dash"]))
    np.testing.assert_allclose(scores.across, 0.03, atol=1e-9)
    assert scores.ratio == pytest.approx([1.0])
    assert scores.width == pytest.approx([0.02])
    np.testing.assert_allclose(scores.ends, 0.0, atol=1e-9)


def test_a_dash_a_metre_aside_is_false_and_the_true_one_is_missed() -> None:
    scores = scored(found(6.0))
    assert (scores.found, scores.true) == (pytest.approx(3.0), 0.0)
    assert (scores.seen["dash"], scores.hit["dash"]) == (pytest.approx(3.0), 0.0)
    assert scores.across == []


@pytest.mark.parametrize(("y", "share"), [(5.05, 1.0), (7.0, 0.0)])
def test_a_kerb_is_held_against_the_true_one_beside_it(y: float, share: float) -> None:
    scores = Scores()
    kerb = Kerb(line(y), np.array([0.10, 0.10]), np.array([0.05, 0.01]), 0.9)
    score_kerbs(scores, [kerb], [TrueKerb(line(5.0), 0.12)], raster(), T)
    assert scores.kerb_found == pytest.approx(3.0)
    assert scores.kerb_true == pytest.approx(3.0 * share)
    assert scores.kerb_hit == pytest.approx(scores.kerb_seen * share)
    if share:
        np.testing.assert_allclose(scores.kerb_across, 0.05, atol=0.001)
        np.testing.assert_allclose(scores.kerb_height, -0.02, atol=1e-9)
        assert scores.height_ratio == pytest.approx([-2.0])
