"""Exact progress of an upload: bytes and files that the server has, speed, and the time that is left."""

import threading
import time
from collections import deque
from typing import Final

from wayloom.config.progress import Progress

WINDOW_S: Final = 30.0
"""Of which the speed is the mean."""
LEAST_S: Final = 0.5


class Counter:
    """Counted from several threads. Bytes that were lost on the way do not let the share fall."""

    def __init__(self, total_bytes: int, total_files: int, progress: Progress) -> None:
        self._total, self._total_files, self._progress = total_bytes, total_files, progress
        self._done, self._files, self._share = 0, 0, 0.0
        self._times: deque[tuple[float, int]] = deque()
        self._lock = threading.Lock()

    def set(self, done: int, files: int) -> None:
        """The server has so much."""
        with self._lock:
            self._done, self._files = done, files
            self._times.clear()
            self._tell()

    def add(self, count: int, files: int = 0) -> None:
        """It has so much more; less where it has lost some."""
        with self._lock:
            self._done, self._files = self._done + count, self._files + files
            self._tell()

    def _tell(self) -> None:
        self._share = max(self._share, min(1.0, self._done / self._total) if self._total else 1.0)
        words = f"{self._done / 1e6:.1f} of {self._total / 1e6:.1f} MB, {self._files} of {self._total_files} files sent"
        self._progress(self._share, words + self._speed())

    def _speed(self) -> str:
        now = time.monotonic()
        self._times.append((now, self._done))
        while self._times[0][0] < now - WINDOW_S:
            self._times.popleft()
        since, before = self._times[0]
        if now - since < LEAST_S or self._done <= before:
            return ""
        bytes_a_second = (self._done - before) / (now - since)
        left_s = (self._total - self._done) / bytes_a_second
        return f", {bytes_a_second / 1e6:.1f} MB/s" + (f", {left_s:.0f} s left" if left_s >= 1.0 else "")
