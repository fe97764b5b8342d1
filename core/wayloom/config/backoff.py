"""Exponential back-off: pauses between tries that double up to a longest one."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Backoff:
    """first_s: the pause after the first failure; longest_s: no pause is longer; tries: how often in all."""

    first_s: float
    longest_s: float
    tries: int = 1

    def pause_s(self, failures: int) -> float:
        """The pause after so many failures in a row, from 1 on."""
        return float(min(self.first_s * 2.0 ** min(failures - 1, 60), self.longest_s))

    def attempts(self, wait: Callable[[float], object] = time.sleep) -> Iterator[bool]:
        """For each try whether it is the last; waits before each but the first. To be left when a try succeeds:

        for is_last in backoff.attempts():
            try:
                return work()
            except PassingError:
                if is_last:
                    raise
        """
        for failures in range(self.tries):
            if failures:
                wait(self.pause_s(failures))
            yield failures == self.tries - 1
