"""Work on one item after the other by several threads, results in the items' order."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(work: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Generator[Result, None, None]:
    """What `work` makes of each item, in the items' order, whichever of the threads is done first.

    No more than threads + 1 results are begun or waiting, so what they hold in memory is bounded. With one thread it works in the
    caller's, an item whenever one is asked for. What `work` raises is raised where its result is due; what is not begun by then
    never is.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    coming: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                coming.append(pool.submit(work, item))
                if len(coming) > threads:
                    yield coming.popleft().result()
            while coming:
                yield coming.popleft().result()
        finally:
            for one in coming:
                one.cancel()
