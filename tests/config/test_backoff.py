"""Exponential back-off."""

import pytest

from wayloom.config.backoff import Backoff


def test_pauses_double_up_to_the_longest():
    backoff = Backoff(0.5, 3.0)
    assert [backoff.pause_s(failures) for failures in (1, 2, 3, 4, 5000)] == [0.5, 1.0, 2.0, 3.0, 3.0]


def test_there_is_a_pause_before_each_try_but_the_first_and_the_last_is_told():
    waited: list[float] = []
    assert list(Backoff(0.25, 16.0, 4).attempts(waited.append)) == [False, False, False, True]
    assert waited == [0.25, 0.5, 1.0]


def test_a_try_that_succeeds_ends_it():
    waited: list[float] = []
    for failures, is_last in enumerate(Backoff(1.0, 1.0, 5).attempts(waited.append)):
        assert not is_last
        if failures == 2:
            break
    assert waited == [1.0, 1.0]


@pytest.mark.parametrize(("tries", "expected"), [(1, [True]), (2, [False, True])])
def test_the_last_of_so_many_tries(tries, expected):
    assert list(Backoff(0.0, 0.0, tries).attempts()) == expected
