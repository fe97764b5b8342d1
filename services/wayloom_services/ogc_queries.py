"""Query parameters of OGC API Features (Part 1, 7.15): box, time, page and filters, refused with 400 where they are none."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any, Final

from fastapi import Query, Request

from wayloom.store.maps import Box
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import box_of_query

LIMIT: Final = 100
MOST: Final = 10_000
AFTER: Final = re.compile(r"-?\d{1,9},-?\d{1,9},\d{1,9}")
OPEN: Final = ("", "..")
Span = tuple[datetime | None, datetime | None]
"""From when to when, both included; None: without an end."""


@dataclass(frozen=True, slots=True)
class ItemsQuery:
    """What of a collection is asked for, as text: the standard wants 400 for what is none, and an upper limit that is cut off."""

    bbox: Annotated[
        str | None, Query(description="west,south,east,north in degrees, or with heights: west,south,low,east,north,high")
    ] = None
    datetime: Annotated[
        str | None,
        Query(description="RFC 3339 time, or from/to, either of which may be `..`: features without a time always match"),
    ] = None
    limit: Annotated[
        str | None,
        Query(description=f"how many features a page has at most, {LIMIT} by default; {MOST} where more are asked for"),
    ] = None
    after: Annotated[str | None, Query(description="where the page begins, of a link to the `next` page")] = None
    kind: Annotated[str | None, Query(description="values of the property `kind`, separated by commas")] = None


@dataclass(frozen=True, slots=True)
class Wanted:
    """The same, read. limit: features of a page; kinds: None for all."""

    box: Box | None
    span: Span | None
    limit: int
    after: str | None
    kinds: frozenset[str] | None
    given: Mapping[str, str] = field(default_factory=dict)

    def has(self, feature: Mapping[str, Any], of: Span | None) -> bool:
        """Whether a feature that is of a time, None: of none, is asked for by time and kind."""
        if self.kinds is not None and feature["properties"].get("kind") not in self.kinds:
            return False
        return self.span is None or of is None or _overlap(self.span, of)


def read_query(request: Request, query: ItemsQuery) -> Wanted:
    """What is asked for. Raises ProtocolError, also for a parameter that there is not."""
    refuse_unknown(request, "bbox", "datetime", "limit", "after", "kind")
    if query.after is not None and not AFTER.fullmatch(query.after):
        raise _bad("after is that of a link to a next page")
    return Wanted(
        box=None if query.bbox is None else _box(query.bbox),
        span=None if query.datetime is None else _span(query.datetime),
        limit=_limit(query.limit),
        after=query.after,
        kinds=None if query.kind is None else frozenset(query.kind.split(",")),
        given=dict(request.query_params),
    )


def refuse_unknown(request: Request, *known: str) -> None:
    """Raises ProtocolError for a parameter that there is not; `f` is left to clients that name the one format."""
    for name in request.query_params:
        if name not in known and not (name == "f" and request.query_params[name] in ("json", "geojson")):
            raise _bad(f"there is no parameter {name[:80]!r}; there are {', '.join(known) or 'none'}")


def _limit(text: str | None) -> int:
    if text is None:
        return LIMIT
    if not re.fullmatch(r"\d{1,18}", text) or int(text) < 1:
        raise _bad("limit is a whole number from 1 on")
    return min(int(text), MOST)


def _box(text: str) -> Box:
    """A box in degrees; heights of a box do not choose."""
    parts = text.split(",")
    return box_of_query(",".join([*parts[:2], *parts[3:5]]) if len(parts) == 6 else text)


def _span(text: str) -> Span:
    parts = text.split("/")
    if len(parts) == 1:
        return _time(text), _time(text)
    if len(parts) != 2 or (all(part in OPEN for part in parts) and "" in parts and ".." not in parts):
        raise _bad("datetime is a time, or from/to")
    first, last = (None if part in OPEN else _time(part) for part in parts)
    if first is not None and last is not None and first > last:
        raise _bad(f"datetime: {parts[0]} is later than {parts[1]}")
    return first, last


def _time(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise _bad(f"datetime: {text[:80]!r} is no RFC 3339 time") from None
    if found.tzinfo is None:
        raise _bad(f"datetime: {text[:80]!r} has no time zone")
    return found


def _overlap(one: Span, other: Span) -> bool:
    return all(a is None or b is None or a <= b for a, b in ((one[0], other[1]), (other[0], one[1])))


def _bad(detail: str) -> ProtocolError:
    return ProtocolError(400, "bad-request", detail)
