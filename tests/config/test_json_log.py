"""The log of a service process: one object a line, and no error where it cannot be written."""

import errno
import io
import json
from collections.abc import Iterator

import pytest
import structlog

from wayloom.config import json_log


@pytest.fixture(autouse=True)
def _settings_as_before() -> Iterator[None]:
    yield
    structlog.reset_defaults()


class FullDisk(io.StringIO):
    """A stream that takes nothing while it is full."""

    is_full = False

    def write(self, text: str) -> int:
        if self.is_full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)

    def flush(self) -> None:
        if self.is_full:
            raise OSError(errno.ENOSPC, "No space left on device")


def test_a_line_that_cannot_be_written_is_lost_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = FullDisk()
    monkeypatch.setattr("sys.stderr", stream)
    json_log.configure_log()
    log = structlog.get_logger()
    log.info("before")
    stream.is_full = True
    log.warning("while it is full")
    stream.is_full = False
    log.info("after")
    assert [json.loads(line)["event"] for line in stream.getvalue().splitlines()] == ["before", "after"]
