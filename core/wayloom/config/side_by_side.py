"""Work on items by several threads, results in the items' order."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Each(Protocol):
    """What `work` makes of each item, in the items' order, as `map` does it or by several threads."""

    def __call__(self, work: Callable[[Item], Result], items: Sequence[Item], /) -> Iterable[Result]: ...


def runs(count: int, parts: int) -> list[slice]:
    """So many items cut into runs that are about as long as one another, `parts` of them or one for each item."""
    parts = max(min(parts, count), 1)
    return [slice(count * k // parts, count * (k + 1) // parts) for k in range(parts)]


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
