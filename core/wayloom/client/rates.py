"""Limit of an upload's speed: so many bytes a second over all of its connections."""

import re
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Final

from wayloom.errors import ConfigError

_RATE: Final = re.compile(r"(\d+(?:\.\d+)?)\s*([kMG]?)(i?)B(?:/s)?")
_POWERS: Final = {"": 0, "k": 1, "M": 2, "G": 3}
STEP_S: Final = 0.1
"""Blocks are parted into what may go in so long, so that a slow link is fed evenly."""


def bytes_a_second(text: str) -> float:
    """A rate as people write it: `2MB/s`, `500kB`, `1.5 MiB/s`. Raises ConfigError."""
    found = _RATE.fullmatch(text.strip())
    rate = 0.0 if found is None else float(found[1]) * (1024.0 if found[3] else 1000.0) ** _POWERS[found[2]]
    if rate < 1.0:
        raise ConfigError(f"{text!r} is no rate", record="--limit-rate", remedy="write one as 2MB/s, 500kB/s or 1MiB/s")
    return rate


class RateLimit:
    """Holds blocks back until their time has come. Safe to share between threads.

    rate : bytes a second; None: no limit
    """

    def __init__(self, rate: float | None = None) -> None:
        self._rate, self._free_at, self._lock = rate, 0.0, threading.Lock()

    def over(self, blocks: Iterable[memoryview]) -> Iterator[memoryview]:
        """The blocks, at their time."""
        if self._rate is None:
            yield from blocks
            return
        step = max(1, int(self._rate * STEP_S))
        for block in blocks:
            for start in range(0, len(block), step):
                part = block[start : start + step]
                time.sleep(self._pause(len(part), self._rate))
                yield part

    def _pause(self, count: int, rate: float) -> float:
        """How long to wait before so many bytes."""
        with self._lock:
            now = time.monotonic()
            begin = max(now, self._free_at)
            self._free_at = begin + count / rate
            return begin - now


UNLIMITED: Final = RateLimit()
