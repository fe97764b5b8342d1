"""The height surface: what holds cells, and what stays as it is."""

import numpy as np
import pytest

from wayloom.ground.raster import Cells
from wayloom.ground.sheet import CELL_M
from wayloom.ground.surface import smooth
from wayloom.ground.view import BESIDE, ROAD

SURE, FAR = 2e4, 60.0
"""1/m^2: of cells that near views see, and that only views from 20 m see."""
SHAPE = (70, 70)
RADIUS = 4
NO_SIDE = np.zeros(SHAPE, np.uint8)


@pytest.fixture
def street():
    """height, information, group of cells of a road that is 2 % steep."""
    height = 0.02 * CELL_M * np.arange(SHAPE[1])[None].repeat(SHAPE[0], axis=0)
    return height, np.full(SHAPE, SURE), np.full(SHAPE, ROAD, np.uint8)


def test_what_only_far_views_tell_is_held_to_the_surface_around_it(street):
    height, information, group = street
    wrong = height.copy()
    wrong[25:45, 25:40] -= 0.15
    information[25:45, 25:40] = FAR
    surface = smooth(Cells(wrong, information, group), NO_SIDE, RADIUS)
    assert np.abs(surface.height - height)[25:45, 25:40].max() < 0.03
    assert np.abs(surface.height - height)[:20].max() < 0.002


def test_a_hump_that_near_views_see_stays(street):
    height, information, group = street
    along = CELL_M * (np.arange(SHAPE[1]) - 35)
    hump = height + 0.08 * np.where(np.abs(along) < 1.5, 0.5 + 0.5 * np.cos(np.pi * along / 1.5), 0.0)
    surface = smooth(Cells(hump, information, group), NO_SIDE, RADIUS)
    assert np.abs(surface.height - hump)[5:-5, 5:-5].max() < 0.015


def test_the_step_between_road_and_what_is_beside_it_stays(street):
    height, information, group = street
    height[:, 40:] += 0.12
    group[:, 40:] = BESIDE
    surface = smooth(Cells(height, information, group), NO_SIDE, RADIUS)
    assert np.abs(surface.height - height)[:, 38:42].max() < 0.003
