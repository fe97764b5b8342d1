"""A real Chromium, and pages of other origins that show what the service serves."""

import http.server
import os
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import httpx2
import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
RENEWED_S = 20.0
"""Pages ask again after 10 s."""


@contextmanager
def chromium(*more: str) -> Iterator[Any]:
    """The browser of the machine, with more arguments. None is a failure in CI and a skip elsewhere."""
    if not CHROMIUM.exists():
        if os.environ.get("CI"):
            pytest.fail(f"no {CHROMIUM}: install Debian's chromium")
        pytest.skip(f"no {CHROMIUM}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=str(CHROMIUM), args=[*ARGUMENTS, *more])
        yield launched
        launched.close()


class Watched:
    """A page and what it complained of: errors on its console, uncaught ones, requests to other servers."""

    def __init__(self, browser: Any, url: str, **options: Any) -> None:
        self.said: list[str] = []
        self.page = browser.new_page(**{"viewport": {"width": 1200, "height": 800}, **options})
        self.page.on("console", lambda message: self.said.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        own = (url, "blob:", "data:")
        self.page.on("request", lambda asked: None if asked.url.startswith(own) else self.said.append(asked.url))


def answering(url: str) -> None:
    """Wait for a server that has only just been started, so that a page's patience is for the page."""
    httpx2.get(f"{url}/healthz", timeout=60.0, trust_env=False)


def without_stream(page: Any) -> None:
    """Events never come: what changes, the page has to ask for."""
    page.route("**/v1/events*", lambda route: None)


@contextmanager
def watched(browser: Any, url: str, path: str = "/", **options: Any) -> Iterator[Any]:
    """A page of a service, which must have nothing to complain of at the end."""
    answering(url)
    seen = Watched(browser, url, **options)
    seen.page.goto(f"{url}{path}")
    yield seen.page
    assert seen.said == []
    seen.page.close()


@contextmanager
def site(folder: Path, pages: Mapping[str, str]) -> Iterator[str]:
    """A web site of a folder and of some pages by their paths. Yields its origin."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments, directory=str(folder))

        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            if self.path not in pages:
                super().do_GET()
                return
            body = pages[self.path].encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def shot(page: Any) -> NDArray[np.uint8]:
    """(h, w, 3) RGB of a page."""
    return np.asarray(cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)[..., ::-1])


TONES = """([colours, scheme]) => import("/static/ui/tones.js").then((tones) => colours.map((one) => tones.tone(one, scheme)))"""


def tones(page: Any, scheme: str | None = None) -> NDArray[np.uint8]:
    """(19, 3) RGB of the classes on the map's ground, as a page of the service computes them. scheme : else the page's own"""
    found = page.evaluate(TONES, [[f"#{colour.tobytes().hex()}" for colour in PALETTE], *([scheme] if scheme else [])])
    return np.array([list(bytes.fromhex(one[1:])) for one in found], np.uint8)


def pixels_by_class(picture: NDArray[np.uint8], palette: NDArray[np.uint8] = PALETTE) -> Counter[str]:
    """How many pixels have the colour of each class, to the 6 levels that eight bits of linear colour leave of dark ones.

    palette : (19, 3) RGB
    """
    apart = np.abs(picture.reshape(-1, 1, 3).astype(int) - palette.astype(int)).max(axis=2)
    near = apart.argmin(axis=1)[apart.min(axis=1) <= 6]
    return Counter({CLASS_NAMES[label]: int(count) for label, count in enumerate(np.bincount(near)) if count})
