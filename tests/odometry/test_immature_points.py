import numpy as np
from made_window import NUMBERS, ROBUST, made_window

from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.arrays import LEFT_ALIKE, RIGHT, RIGHT_ALIKE, Robust
from wayloom.odometry.points import immature

STRICT = ROBUST._replace(max_energy=70.0)


def waiting_window(known: bool, robust: Robust = STRICT, off: float = 1.02) -> tuple[Window, np.ndarray]:
    """A window whose newest keyframe's points wait, their inverse depths `off` times the truth, and the true ones."""
    window = made_window(4, 80, disturbed=False)
    mine = window.points.host == 3
    pixels, truth = window.points.uv[mine].astype(np.int64), window.points.rho[mine].copy()
    rho = truth * off if known else 0 * truth
    immature.add(window, immature.of_pixels(window, pixels, rho, 1000, 50.0, NUMBERS, robust))
    return window, truth


def test_matched_points_are_known_at_once_and_others_when_an_older_keyframe_shows_them() -> None:
    window, truth = waiting_window(True)
    assert immature.known(window.immature).all()
    assert len(window.immature.id) > 0.5 * len(truth)
    window, truth = waiting_window(False)
    assert not immature.known(window.immature).any()
    immature.trace(window, NUMBERS, STRICT)
    known = immature.known(window.immature)
    assert known.sum() > 15
    rows = window.immature.id - 1000
    assert np.median(np.abs(window.immature.points.rho / truth[rows] - 1.0)[known]) < 0.03


def test_matched_points_are_known_whatever_the_static_terms_weigh() -> None:
    weighed, _ = waiting_window(True, off=1.0)
    unweighed, _ = waiting_window(True, STRICT._replace(static_weight=0.0, observer_right_weight=0.0), off=1.0)
    assert immature.known(unweighed.immature).all()
    assert unweighed.immature.points.has_static.all()
    assert len(unweighed.immature.id) > 0.9 * len(weighed.immature.id)
    assert unweighed.immature.information.max() < 1e-3 * weighed.immature.information.min()


def test_looking_at_more_keyframes_makes_depths_better_and_surer() -> None:
    window, truth = waiting_window(True)
    before, information = window.immature.points.rho.copy(), window.immature.information.copy()
    rows = window.immature.id - 1000
    immature.trace(window, NUMBERS, STRICT)
    np.testing.assert_array_equal(window.immature.id, rows + 1000)
    assert (window.immature.information > information).mean() > 0.5
    error = [np.median(np.abs(rho / truth[rows] - 1.0)) for rho in (before, window.immature.points.rho)]
    assert error[1] <= error[0]


def test_observations_name_the_point_and_the_keyframe() -> None:
    window, _ = waiting_window(True)
    observations = immature.trace(window, NUMBERS, STRICT)
    assert set(observations[:, 1]) == {1, 2}  # the two keyframes before their own
    assert set(observations[:, 0]) <= set(range(1000, 1080))
    assert len(np.unique(observations[:, :2], axis=0)) == len(observations)
    for bit in (RIGHT, LEFT_ALIKE, RIGHT_ALIKE):
        assert (observations[:, 2] & bit > 0).mean() > 0.7
    assert not (observations[observations[:, 2] & RIGHT == 0, 2] & RIGHT_ALIKE).any()


def test_points_that_fit_nowhere_are_forgotten() -> None:
    window, _ = waiting_window(False)
    window.immature.points.colour[:] = np.random.default_rng(0).uniform(0, 255, window.immature.points.colour.shape)
    immature.trace(window, NUMBERS, STRICT)
    assert len(window.immature.id) < 40


def test_taking_points_out_gives_the_known_ones_and_forgets_the_rest() -> None:
    window, _ = waiting_window(False)
    immature.trace(window, NUMBERS, STRICT)
    known = immature.known(window.immature)
    gone = np.arange(len(known)) % 2 == 0
    taken = immature.take(window, gone)
    np.testing.assert_array_equal(len(taken.id), (known & gone).sum())
    assert (taken.information > 0).all()
    assert len(window.immature.id) == (~gone).sum()
