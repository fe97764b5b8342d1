"""Values of the database that change slowly and are asked for often: read once, then held for some seconds by this process."""

import time
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

from wayloom.store.database import Session

T = TypeVar("T")


class Held(Generic[T]):
    """What `read` finds, at most `lasts_s` seconds old. Safe to share between threads: one of them reads, others that ask meanwhile
    get what was held before, where there is something."""

    def __init__(self, read: Callable[[Session], T], lasts_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._read, self._lasts_s, self._clock = read, lasts_s, clock
        self._lock = Lock()
        self._found: tuple[float, T] | None = None

    def __call__(self, session: Session) -> T:
        found = self._found
        if found is not None and (self._clock() < found[0] or not self._lock.acquire(blocking=False)):
            return found[1]
        if found is None:
            self._lock.acquire()
        try:
            if self._found is not found and self._found is not None:
                return self._found[1]
            value = self._read(session)
            self._found = (self._clock() + self._lasts_s, value)
            return value
        finally:
            self._lock.release()
