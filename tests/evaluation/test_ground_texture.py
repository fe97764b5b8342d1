"""Correlation of an orthophoto with the true texture."""

from dataclasses import replace

import numpy as np
import pytest

from wayloom.evaluation.ground_texture import BLOCK_PX, block_correlation, texture_correlation
from wayloom.evaluation.made_ground import made_sheet
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings


@pytest.fixture(scope="module")
def world():
    return build_world(CitySettings(seed=3), LightSettings(haze_per_m=0.0), "quarter")


@pytest.fixture(scope="module")
def sheet(world):
    node = world.city.graph.nodes[6]
    return made_sheet(world, (float(node[0]), float(node[1])), (8.0, 6.0))


def test_cells_are_correlated_as_numpy_correlates_their_seen_pixels():
    rng = np.random.default_rng(3)
    one, other = rng.normal(size=(2, 2 * BLOCK_PX, 3 * BLOCK_PX))
    other += 0.7 * one
    seen = rng.random(one.shape) < 0.97
    seen[:BLOCK_PX, :BLOCK_PX] = rng.random((BLOCK_PX, BLOCK_PX)) < 0.5
    found = block_correlation(one, other, seen)
    assert np.isnan(found[0, 0])
    for r, c in [(0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]:
        part = (slice(BLOCK_PX * r, BLOCK_PX * (r + 1)), slice(BLOCK_PX * c, BLOCK_PX * (c + 1)))
        expected = np.corrcoef(one[part][seen[part]], other[part][seen[part]])[0, 1]
        np.testing.assert_allclose(found[r, c], expected, rtol=1e-9)


def test_the_truth_correlates_with_itself_and_a_moved_picture_does_not(world, sheet):
    same, sharpness = texture_correlation(sheet, sheet.T_submap_sheet, world)
    assert len(same) > 30
    assert (sharpness == 255.0).all()
    assert np.median(same) > 0.95
    moved = replace(sheet, colour=np.roll(sheet.colour, 4, axis=1))
    assert np.median(texture_correlation(moved, sheet.T_submap_sheet, world)[0]) < np.median(same) - 0.2
