import numpy as np

from mapping.test_drive_graph import NOISE, exact_fixes, straight
from wayloom.mapping.drive_graph import CLOCK_SIGMAS, HINTED_SIGMAS, clock_sigmas
from wayloom.mapping.heavy_tails import heavy_tailed


def test_the_drive_lies_where_fixes_are_dense_and_not_at_their_mean() -> None:
    chain = straight(120)
    fixes = exact_fixes(chain, 0.1)
    rng = np.random.default_rng(0)
    fixes.position_enu[:] += rng.normal(size=(120, 3)) * 0.3
    wild = rng.random(120) < 0.4
    fixes.position_enu[wild] += [30.0, 0.0, 0.0]
    tails = heavy_tailed(chain, fixes, chain.T_world_node, NOISE)
    assert abs(np.median(tails.T_enu_node[:, 0, 3])) < 0.5  # the mean fix is 12 m off
    assert tails.inflation > 2.0
    sigma = np.sqrt(tails.fixes.covariance[:, 0, 0])
    assert np.abs(np.diff(np.log(sigma))).max() < np.log(1.5)  # slowly: it stays one process


def test_a_clock_is_told_by_the_drive_and_never_by_its_prior() -> None:
    prior = NOISE.time_offset_s
    told = 0.1 * prior
    assert clock_sigmas(0.0, told**2, NOISE) == 0.0
    assert clock_sigmas(9.0 * told, told**2, NOISE) > CLOCK_SIGMAS
    assert clock_sigmas(0.3 * prior, (0.99 * prior) ** 2, NOISE) < HINTED_SIGMAS  # hardly more is known than before
