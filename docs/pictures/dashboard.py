"""Pictures of the dashboard's pages (docs/dashboard.md), of a service that is running.

wayloom demo --port 8088          # leaves the dashboard running
python docs/pictures/dashboard.py --to http://127.0.0.1:8088 --out docs/pictures
"""

import argparse
import sys
from pathlib import Path
from typing import Any, Final

import cv2
import httpx2
import numpy as np
from playwright.sync_api import sync_playwright

CHROMIUM: Final = "/usr/bin/chromium"
ARGUMENTS: Final = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
MOST_BYTES: Final = 150_000
WIDE, NARROW = (1280, 800), (390, 780)
SETTLE_MS: Final = 2500
PATIENCE_MS: Final = 60_000
"""A map without a graphics card takes seconds to draw."""
DRAWN: Final = "!document.querySelector('.board') || (globalThis.wayloomMap?.areTilesLoaded() && wayloomMap.getLayer('semantic'))"


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--to", default="http://127.0.0.1:8088")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    asked = parser.parse_args()
    (drive, *_) = httpx2.get(f"{asked.to}/v1/drives?state=done", trust_env=False).json()["drives"]
    wanted: dict[str, tuple[str, str, tuple[int, int], bool]] = {
        "dashboard": ("/", "light", WIDE, False),
        "dashboard-narrow": ("/", "dark", NARROW, False),
        "dashboard-drive": (f"/drives/{drive['id']}", "light", WIDE, True),
        "dashboard-fleet": ("/fleet", "dark", WIDE, False),
    }
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        for name, (path, scheme, size, whole) in wanted.items():
            content = picture(browser, asked.to + path, scheme, size, whole)
            (asked.out / f"{name}.webp").write_bytes(content)
            sys.stdout.write(f"{name}.webp  {len(content)} bytes\n")
        browser.close()


def picture(browser: Any, url: str, scheme: str, size: tuple[int, int], whole: bool) -> bytes:
    """A page as WebP, as good as MOST_BYTES allow. whole : all of it, not what a window shows"""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
    page.goto(url, timeout=PATIENCE_MS)
    quiet = 0
    for _ in range(PATIENCE_MS // 500):  # asked one by one: the page's policy lets nothing else run in it
        quiet = quiet + 1 if page.evaluate(DRAWN) else 0
        if quiet == 6:
            break
        page.wait_for_timeout(500)
    page.wait_for_timeout(SETTLE_MS)
    shot = cv2.imdecode(np.frombuffer(page.screenshot(full_page=whole), np.uint8), cv2.IMREAD_COLOR)
    page.close()
    for quality in (90, 80, 70, 60, 50, 40):
        content = cv2.imencode(".webp", shot, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
        if len(content) <= MOST_BYTES:
            return content
    raise SystemExit(f"{url}: its picture does not fit into {MOST_BYTES} bytes")


if __name__ == "__main__":
    main()
