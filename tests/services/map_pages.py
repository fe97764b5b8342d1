"""The dashboard's map opened in a Chromium, with what went wrong on it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from service_kit.browsers import shot, tones
from service_kit.looked_at import LookedAt
from service_kit.running import until
from wayloom.config.classes import CLASS_ID

READY = "!!globalThis.wayloomTools && wayloomMap.loaded() && !wayloomMap.isMoving() && !wayloomTools.address.quiet"
Open = Callable[..., Any]


@contextmanager
def opening(browser: Any, shown: LookedAt) -> Iterator[Open]:
    """Opens maps with what is behind `#`; at the end none may have complained."""
    said: list[str] = []
    pages: list[Any] = []

    def open_(words: str = "") -> Any:
        page = browser.new_page(viewport={"width": 1300, "height": 800}, color_scheme="light")
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(f"{shown.api.url}/#{words}")
        until(lambda: page.evaluate(READY) and page.evaluate("!!wayloomMap.getLayer('semantic')"), 90)
        pages.append(page)
        return page

    yield open_
    for page in pages:
        page.close()
    assert said == []


def tone(page: Any, name: str) -> tuple[int, int, int]:
    """The colour of a class on the map."""
    red, green, blue = tones(page)[CLASS_ID[name]].tolist()
    return red, green, blue


def like(page: Any, colour: tuple[int, int, int], within: int = 24) -> int:
    """How many pixels of the map have about this colour; the panels on its left are left out."""
    picture = shot(page)[60:700, 330:900].astype(int)
    return int((np.abs(picture - colour).max(axis=2) <= within).sum())
