"""Streams of events for one caller: a vehicle hears of its own drives alone, nobody for longer than its key is good."""

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing
from typing import Final

from fastapi import Request
from sse_starlette import ServerSentEvent

from wayloom.store.access import owners
from wayloom.store.access.owners import Owner
from wayloom.store.database import DatabaseError
from wayloom_services.access.callers import caller_of
from wayloom_services.access.guard import find_caller
from wayloom_services.context import Service
from wayloom_services.errors import ProtocolError

CHECK_S: Final = 10.0
"""How often it is asked whether the listener may still hear."""
PAUSE_S: Final = 2.0
"""Until a database that was away is asked again."""


async def stream_for(
    request: Request, service: Service, messages: AsyncIterator[ServerSentEvent], check_s: float = CHECK_S
) -> AsyncIterator[ServerSentEvent]:
    """Those of the messages that the caller may hear, as long as it may."""
    caller = caller_of(request.scope)

    async def is_still() -> bool:
        return not service.settings.is_closed or await find_caller(service, request.scope) == caller

    seen: dict[str, bool] = {}
    async with aclosing(while_allowed(messages, is_still, check_s)) as heard:  # type: ignore[type-var]
        async for message in heard:
            if caller.owner is None or await _is_of(caller.owner, message, service, seen):
                yield message


async def while_allowed(
    messages: AsyncIterator[ServerSentEvent], is_still: Callable[[], Awaitable[bool]], check_s: float
) -> AsyncIterator[ServerSentEvent]:
    """The messages, until it is not so any more; asked every `check_s`, whether there are messages or not. While the database is
    away nobody can say: it is asked again."""
    clock = asyncio.get_running_loop().time
    checked, following = clock(), asyncio.ensure_future(anext(messages))
    try:
        while True:
            done, _ = await asyncio.wait([following], timeout=max(0.0, checked + check_s - clock()))
            if clock() - checked >= check_s:
                if not await _unless_away(is_still):
                    return
                checked = clock()
            if done:
                message, following = following.result(), asyncio.ensure_future(anext(messages))
                yield message
    finally:
        following.cancel()


async def _unless_away(is_still: Callable[[], Awaitable[bool]]) -> bool:
    try:
        return await is_still()
    except ProtocolError:
        return True


async def _is_of(owner: Owner, message: ServerSentEvent, service: Service, seen: dict[str, bool]) -> bool:
    """Whether a message is about a drive of the owner's. A drive that is removed is its own where it was before."""
    if message.event not in ("drive", "removed"):
        return False
    drive_id = str(json.loads(str(message.data))["id"])
    if message.event == "removed":
        return seen.pop(drive_id, False)
    if drive_id not in seen:
        seen[drive_id] = await _as_soon_as_it_answers(
            lambda: service.read(lambda session: owners.is_of(session, drive_id, owner.name))
        )
    return seen[drive_id]


async def _as_soon_as_it_answers(ask: Callable[[], Awaitable[bool]], pause_s: float = PAUSE_S) -> bool:
    """What the database says, when it is there again."""
    while True:
        try:
            return await ask()
        except DatabaseError:
            await asyncio.sleep(pause_s)
