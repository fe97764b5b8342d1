"""Answers to an upload whose bytes cannot be stored."""

from collections.abc import Iterator
from contextlib import contextmanager

from wayloom_services.errors import ProtocolError


@contextmanager
def told() -> Iterator[None]:
    """Around the work on an upload's files: 423 where another process writes to them, 507 where the disk does not take them."""
    try:
        yield
    except BlockingIOError:
        raise ProtocolError(423, "taken-over", "another process of this service writes to this upload") from None
    except OSError as error:
        raise ProtocolError(507, "no-space", f"the bytes could not be stored: {error.strerror}") from error
