import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.tiles.preview import PAPER, TRACK, bar_length_m, top_down


def test_a_preview_shows_points_in_their_colours_and_north_is_up():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 0.0, 0.0]])
    labels = np.array([CLASS_ID["car"], CLASS_ID["road"], CLASS_ID["vegetation"]], np.uint8)
    picture = top_down(points, labels, 0.1)
    at = {
        name: np.argwhere((picture == PALETTE[CLASS_ID[name]]).all(axis=2)).mean(axis=0) for name in ("car", "road", "vegetation")
    }
    assert at["road"][0] == pytest.approx(at["car"][0] - 200, abs=1)
    assert at["vegetation"][1] == pytest.approx(at["car"][1] + 200, abs=1)


def test_in_a_preview_the_higher_point_covers_the_lower():
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 0.0], [3.0, 3.0, 0.0]])
    picture = top_down(points, np.array([8, 0, 2], np.uint8), 0.1)
    assert (picture == PALETTE[8]).all(axis=2).any()
    assert not (picture == PALETTE[0]).all(axis=2).any()


def test_a_preview_never_outgrows_its_limit_and_draws_tracks():
    track = np.column_stack([np.linspace(0, 5000, 50), np.zeros(50), np.zeros(50)])
    picture = top_down(np.zeros((0, 3)), np.zeros(0, np.uint8), 0.1, tracks_enu=(track,), max_size_px=800)
    assert max(picture.shape) <= 802
    assert (picture == TRACK).all(axis=2).sum() > 500


def test_a_preview_of_nothing_is_paper_with_a_scale():
    picture = top_down(np.zeros((0, 3)), np.zeros(0, np.uint8))
    assert (picture == PAPER).all(axis=2).mean() > 0.5


def test_scale_bars_are_round_lengths():
    assert [bar_length_m(x) for x in (1.0, 1.9, 3.0, 7.0, 49.0, 1200.0)] == [1.0, 1.0, 2.0, 5.0, 20.0, 1000.0]
