"""Bodies of uploads: nothing is written to a file any more when the request is over, however it ends."""

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from wayloom_services.tus_body import BUFFER, _Pipe


class SlowSink:
    """Where storing takes until it is allowed to end."""

    def __init__(self) -> None:
        self.begun, self.may_end, self.ended = threading.Event(), threading.Event(), False

    def take(self, content: memoryview) -> None:
        self.begun.set()
        assert self.may_end.wait(10)
        self.ended = True


def service() -> Any:
    return SimpleNamespace(in_thread=asyncio.to_thread)


@pytest.mark.parametrize("times", [1, 2])
def test_a_request_that_is_cancelled_ends_when_the_thread_has_stored_what_it_was_given(times: int) -> None:
    sink = SlowSink()

    async def request() -> None:
        async with _Pipe(service(), sink.take) as pipe:
            await pipe.put(bytes(2 * BUFFER))  # the second buffer waits for the first

    async def cancelled() -> None:
        task = asyncio.create_task(request())
        await asyncio.to_thread(sink.begun.wait, 10)
        for _ in range(times):
            task.cancel()
            await asyncio.sleep(0.05)
        assert not task.done()
        sink.may_end.set()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert sink.ended

    asyncio.run(cancelled())
