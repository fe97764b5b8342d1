"""Work by several threads: order, bound, errors, and a caller that stops asking."""

import threading
import time

import pytest

from wayloom.config.side_by_side import in_order, runs


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_items_order(threads: int) -> None:
    def work(n: int) -> int:
        time.sleep(0.002 * (n % 3))
        return n * n

    assert list(in_order(work, range(40), threads)) == [n * n for n in range(40)]
    assert list(in_order(work, [], threads)) == []


@pytest.mark.parametrize("threads", [2, 4])
def test_items_are_worked_on_at_the_same_time(threads: int) -> None:
    """Each waits for all the others of its kind: one after the other they would wait for ever."""
    meeting = threading.Barrier(threads, timeout=20)
    assert len(list(in_order(lambda _: meeting.wait(), range(3 * threads), threads))) == 3 * threads


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_no_more_is_begun_than_may_wait(threads: int) -> None:
    begun: list[int] = []
    results = in_order(begun.append, range(1000), threads)
    for taken in range(1, 30):
        next(results)
        time.sleep(0.002)
        assert len(begun) <= taken + threads
    results.close()
    assert len(begun) < 40


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_is_raised_where_its_result_is_due(threads: int) -> None:
    begun: list[int] = []

    def work(n: int) -> int:
        begun.append(n)
        if n == 5:
            raise ValueError("the sixth")
        return n

    results = in_order(work, range(1000), threads)
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match="the sixth"):
        next(results)
    assert len(begun) <= 6 + 2 * threads


@pytest.mark.parametrize(("count", "parts"), [(10, 4), (3, 4), (1, 4), (0, 4), (8, 1)])
def test_runs_hold_each_item_once_and_are_about_as_long(count: int, parts: int) -> None:
    cut = runs(count, parts)
    assert [i for run in cut for i in range(count)[run]] == list(range(count))
    lengths = [run.stop - run.start for run in cut]
    assert max(lengths) - min(lengths) <= 1
    assert len(cut) == max(min(count, parts), 1)
