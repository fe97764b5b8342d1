import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.tiles.preview import MARGIN_PX, PAPER, TRACK, bar_length_m, top_down


def test_a_preview_shows_points_in_their_colours_and_north_is_up():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 0.0, 0.0]])
    labels = np.array([CLASS_ID["car"], CLASS_ID["road"], CLASS_ID["vegetation"]], np.uint8)
    picture = top_down([(points, labels)], 0.1)
    at = {
        name: np.argwhere((picture == PALETTE[CLASS_ID[name]]).all(axis=2)).mean(axis=0) for name in ("car", "road", "vegetation")
    }
    assert at["road"][0] == pytest.approx(at["car"][0] - 200, abs=1)
    assert at["vegetation"][1] == pytest.approx(at["car"][1] + 200, abs=1)


def test_in_a_preview_the_higher_point_covers_the_lower():
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 0.0], [3.0, 3.0, 0.0]])
    picture = top_down([(points, np.array([8, 0, 2], np.uint8))], 0.1)
    assert (picture == PALETTE[8]).all(axis=2).any()
    assert not (picture == PALETTE[0]).all(axis=2).any()


def test_a_preview_shows_what_drawing_from_the_lowest_upwards_would_and_in_blocks_the_same():
    rng = np.random.default_rng(5)
    points = np.round(rng.normal(0.0, [4.0, 4.0, 1.0], (3000, 3)), 1)  # many as high as one another: of equals the last one shows
    labels = rng.integers(0, 19, len(points)).astype(np.uint8)
    points[::50] = np.nan
    known = np.isfinite(points[:, 0])
    low = points[known, :2].min(axis=0)
    picture = top_down([(points, labels)], 0.1)
    last = picture.shape[0] - 1 - MARGIN_PX
    column, row = (np.rint((points[known, :2] - low) / 0.1).astype(int) * [1, -1] + [MARGIN_PX, last]).T
    drawn = np.full(picture.shape, PAPER, np.uint8)
    for dy, dx in np.ndindex(2, 2):
        for i in np.argsort(points[known, 2], kind="stable"):
            drawn[row[i] + dy, column[i] + dx] = PALETTE[labels[known][i]]
    seen = (drawn != PAPER).any(axis=2)
    np.testing.assert_array_equal(picture[seen], drawn[seen])
    blocks = [(points[i : i + 700], labels[i : i + 700]) for i in range(0, len(points), 700)]
    np.testing.assert_array_equal(top_down(blocks, 0.1), picture)


def test_a_preview_never_outgrows_its_limit_and_draws_tracks():
    track = np.column_stack([np.linspace(0, 5000, 50), np.zeros(50), np.zeros(50)])
    picture = top_down([], 0.1, tracks_enu=(track,), max_size_px=800)
    assert max(picture.shape) <= 802
    assert (picture == TRACK).all(axis=2).sum() > 500


def test_a_preview_of_nothing_is_paper_with_a_scale():
    picture = top_down([])
    assert (picture == PAPER).all(axis=2).mean() > 0.5


def test_scale_bars_are_round_lengths():
    assert [bar_length_m(x) for x in (1.0, 1.9, 3.0, 7.0, 49.0, 1200.0)] == [1.0, 1.0, 2.0, 5.0, 20.0, 1000.0]
