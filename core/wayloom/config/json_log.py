"""JSON log of a service process: one object a line on stderr, with the job's and drive's id where there is one."""

import contextlib
import logging
import sys
from typing import IO

import structlog


class UnfailingStream:
    """A text stream that loses what cannot be written, as on a full disk: no job ends because nobody can be told of it."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, or lose it."""
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush; what is left in the buffer comes with a later line."""
        with contextlib.suppress(OSError):
            self._stream.flush()


def configure_log() -> None:
    """To be called once, before the first line."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(UnfailingStream(sys.stderr)),  # type: ignore[arg-type]
    )
