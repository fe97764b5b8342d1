from dataclasses import replace

import numpy as np
import pytest
from drawn_ground import kerbed

from wayloom.ground.markings.kerbs import find_kerbs


@pytest.mark.parametrize("height", [0.06, 0.12, 0.2])
def test_a_kerb_has_its_height_and_place(height: float) -> None:
    (kerb,) = find_kerbs(kerbed(height, 8.0, 8.1, noise_m=0.008))
    assert np.abs(kerb.height_m - height).max() < 0.02
    assert np.abs(kerb.line[:, 1] - 8.0).max() < 0.06
    assert kerb.length_m > 28.0
    assert kerb.confidence > 0.8


def test_the_road_lies_on_a_kerbs_left() -> None:
    (kerb,) = find_kerbs(kerbed(0.12, 8.0, 8.0, noise_m=0.005))
    step = kerb.line[-1] - kerb.line[0]
    assert step[0] < 0  # the road is in the south: west-bound it lies on the left


def test_the_border_of_the_labels_alone_is_no_kerb() -> None:
    assert find_kerbs(kerbed(0.0, 8.0, 8.0, noise_m=0.01)) == []


def test_a_wall_is_no_kerb() -> None:
    assert find_kerbs(kerbed(0.6, 8.0, 8.0, noise_m=0.01)) == []


def test_a_slope_across_the_road_is_no_kerb() -> None:
    assert find_kerbs(kerbed(0.0, 8.0, 8.0, noise_m=0.006, slope=0.1)) == []


def test_the_step_wins_where_the_labels_are_off() -> None:
    (kerb,) = find_kerbs(kerbed(0.12, 8.0, 8.25, noise_m=0.006))
    assert np.abs(kerb.line[:, 1] - 8.0).max() < 0.08


def test_missing_cells_leave_a_kerb_whole() -> None:
    ground = kerbed(0.12, 8.0, 8.0, noise_m=0.006)
    holes = np.random.default_rng(2).random(ground.height.shape) < 0.4
    (kerb,) = find_kerbs(replace(ground, height=np.where(holes, np.nan, ground.height)))
    assert kerb.length_m > 25.0
    assert np.abs(np.median(kerb.height_m) - 0.12) < 0.015
