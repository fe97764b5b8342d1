"""Token buckets: rates of requests by name, in the memory of one process.

In memory because a count in the database would make a write of every read; n processes let through n times as much, which is
what a limit against floods may do. Quotas, which must be exact, are counted in the database (`wayloom.store.access.quotas`).
"""

import time
from collections import OrderedDict
from collections.abc import Callable


class TokenBuckets:
    """A bucket for each name: it holds `burst` tokens and gets `rate_per_s`. Of more than `most` names the idlest is forgotten."""

    def __init__(self, rate_per_s: float, burst: int, most: int = 10_000, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._most, self._clock = rate_per_s, float(burst), most, clock
        self._held: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, name: str) -> float:
        """Take a token. 0.0 where there was one, else the seconds until there is."""
        now = self._clock()
        tokens, since = self._held.pop(name, (self._burst, now))
        tokens = min(self._burst, tokens + (now - since) * self._rate)
        wait_s = 0.0 if tokens >= 1.0 else (1.0 - tokens) / self._rate
        self._held[name] = (tokens - 1.0 if wait_s == 0.0 else tokens, now)
        if len(self._held) > self._most:
            self._held.popitem(last=False)
        return wait_s
