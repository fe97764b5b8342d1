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
import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser of the machine. None is a failure in CI and a skip elsewhere."""
    if not CHROMIUM.exists():
        if os.environ.get("CI"):
            pytest.fail(f"no {CHROMIUM}: install Debian's chromium")
        pytest.skip(f"no {CHROMIUM}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(ARGUMENTS))
        yield launched
        launched.close()


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


def pixels_by_class(picture: NDArray[np.uint8]) -> Counter[str]:
    """How many pixels have the colour of each class, to the 6 levels that eight bits of linear colour leave of dark ones."""
    apart = np.abs(picture.reshape(-1, 1, 3).astype(int) - PALETTE.astype(int)).max(axis=2)
    near = apart.argmin(axis=1)[apart.min(axis=1) <= 6]
    return Counter({CLASS_NAMES[label]: int(count) for label, count in enumerate(np.bincount(near)) if count})
