"""Pictures of the dashboard's map and 3D page, of a service that runs: python docs/pictures/dashboard_map.py URL

Draws docs/pictures/dashboard-map.jpg and dashboard-3d.jpg with the Chromium of the machine.
"""

import sys
import time
from pathlib import Path
from typing import Any

import httpx2
from playwright.sync_api import sync_playwright

HERE = Path(__file__).parent
CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ("--headless", "--no-sandbox", "--disable-gpu")
SIZE = {"width": 1400, "height": 800}
WAIT_MS = 120_000


def main(url: str) -> None:
    """Both pictures of the newest drive's place."""
    drive = httpx2.get(f"{url}/v1/drives", trust_env=False).json()["drives"][0]["id"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        page = browser.new_page(viewport=SIZE, color_scheme="light", bypass_csp=True)  # what waits here evaluates text
        page.goto(f"{url}/#tracks=vehicle")
        page.wait_for_function("globalThis.wayloomTools && !wayloomTools.address.quiet && wayloomMap.loaded()", timeout=WAIT_MS)
        taken(page, "dashboard-map.jpg")
        page.goto(f"{url}/3d#drive={drive}")
        page.wait_for_function("globalThis.wayloom3d?.flight.length > 0 && wayloom3d.scene.isSettled", timeout=WAIT_MS)
        page.evaluate("wayloom3d.flight.goTo(0.3)")
        taken(page, "dashboard-3d.jpg")
        browser.close()


def taken(page: Any, name: str) -> None:
    """A page's picture, when it has been drawn."""
    time.sleep(3.0)
    page.screenshot(path=str(HERE / name), type="jpeg", quality=82)


if __name__ == "__main__":
    main(sys.argv[1].rstrip("/"))
