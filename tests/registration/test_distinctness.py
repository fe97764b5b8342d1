"""Distinctness: edges, poles and gaps tell where along a street a view is; even walls do not."""

import numpy as np

from registration.made_streets import made_street, view_of
from registration.test_registration import pair
from wayloom.registration.distinctness import distinctness
from wayloom.registration.scene import prepare
from wayloom.registration.settings import RegistrationSettings

SETTINGS = RegistrationSettings()
ALONG_Y = np.diag([0.01, 1.0, 0.01, 0.01, 0.01, 0.01])


def test_a_right_pose_is_distinct_and_one_further_along_is_not() -> None:
    for seed in range(3):
        view_a, view_b, T_a_b = pair(seed, 4.0, forward=False)
        a, b = prepare(view_a, SETTINGS), prepare(view_b, SETTINGS)
        beside = T_a_b.copy()
        beside[1, 3] += 4.0
        assert distinctness(a, b, T_a_b, ALONG_Y) > 0.3
        assert distinctness(a, b, beside, ALONG_Y) < 0.5 * distinctness(a, b, T_a_b, ALONG_Y)


def test_it_is_the_same_both_ways() -> None:
    view_a, view_b, T_a_b = pair(1, 4.0)
    a, b = prepare(view_a, SETTINGS), prepare(view_b, SETTINGS)
    there, back = distinctness(a, b, T_a_b, ALONG_Y), distinctness(b, a, np.linalg.inv(T_a_b), ALONG_Y)
    # The shifts are the same; only the tilt of one level frame against the other, under a degree, differs.
    assert abs(there - back) < 0.05 * there


def test_the_ground_alone_is_not_distinct() -> None:
    view, _ = view_of(made_street(0), 90.0, 0)
    flat = prepare(view, SETTINGS)
    flat.group[:] = 0
    assert distinctness(flat, flat, np.eye(4), ALONG_Y) == 0.0
