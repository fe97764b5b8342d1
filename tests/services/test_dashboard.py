"""The dashboard in a real browser: it shows map, drives and errors, follows what changes, and says nothing on the console."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from service_kit.packed_drives import packed_drive
from service_kit.running import service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
SHOWN = "!!globalThis.wayloomMap?.getLayer('semantic') && wayloomMap.loaded() && !wayloomMap.isMoving()"


@pytest.fixture
def browser() -> Iterator[Any]:
    if not CHROMIUM.exists():
        if os.environ.get("CI"):
            pytest.fail(f"no {CHROMIUM}: install Debian's chromium")
        pytest.skip(f"no {CHROMIUM}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(ARGUMENTS))
        yield launched
        launched.close()


@pytest.mark.browser
def test_the_dashboard_shows_map_and_drives_and_follows_them(browser: Any, tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api, url = up.api(), up.url
        first = upload(api, packed_drive(tmp_path / "a", "first drive"))["id"]
        wait_for_drive(api, first)
        page = browser.new_page(viewport={"width": 1200, "height": 750})
        said: list[str] = []
        tiles: list[int] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("response", lambda answer: tiles.append(answer.status) if "/tiles/semantic/" in answer.url else None)
        page.on(
            "request", lambda request: said.append(request.url) if not request.url.startswith((url, "blob:", "data:")) else None
        )
        page.goto(url)
        page.wait_for_selector(f"[data-id='{first}'][data-state=done]")
        until(lambda: page.evaluate(SHOWN) and 200 in tiles)
        assert page.inner_text("#version") == "city · version 1"
        assert page.inner_text("#live") == "live"
        assert page.evaluate("wayloomMap.getZoom()") > 14
        assert page.evaluate("wayloomMap.queryRenderedFeatures({layers: ['tracks']}).length") > 0

        bad = upload(api, packed_drive(tmp_path / "b", "broken drive", {"odometry": {"bad": True}}))["id"]
        page.wait_for_selector(f"[data-id='{bad}'] .error")
        assert "record it again" in page.inner_text(f"[data-id='{bad}'] .error")
        slow = upload(api, packed_drive(tmp_path / "c", "slow drive", {"odometry": {"seconds": 2.0}}))["id"]
        page.wait_for_selector(f"[data-id='{slow}'][data-state=running]")
        until(lambda: "odometry" in page.inner_text(f"[data-id='{slow}'] .words"))
        page.wait_for_selector(f"[data-id='{slow}'][data-state=done]")
        until(lambda: page.inner_text("#version") == "city · version 2")
        until(lambda: page.evaluate(SHOWN))
        page.click("#show-coverage")
        page.click("#fit")
        until(
            lambda: page.evaluate("!wayloomMap.isMoving() && wayloomMap.queryRenderedFeatures({layers: ['coverage']}).length > 0")
        )
        api.once("DELETE", f"/v1/drives/{bad}")
        page.wait_for_selector(f"[data-id='{bad}']", state="detached")
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_page_of_a_held_drive_tells_why_and_an_operator_releases_it_there(browser: Any, tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api, url = up.api(), up.url
        held = upload(api, packed_drive(tmp_path / "a", "narrow street", {"grade": "D"}))["id"]
        wait_for_drive(api, held)
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(url)
        page.wait_for_selector(f"[data-id='{held}'][data-state=held]")
        assert "grade D: sigma of the position 2.00 m" in page.inner_text(f"[data-id='{held}'] .words")
        assert page.inner_text(f"[data-id='{held}'] .grade") == "D"
        page.click(f"[data-id='{held}'] .report")
        page.wait_for_selector("img.plot")
        until(lambda: page.evaluate("document.querySelector('img.plot').naturalWidth") == 80)
        assert page.inner_text("#verdict") == "Grade D, held: it waits for an operator"
        page.fill("#by", "Ada")
        page.fill("#why", "checked against the plan")
        page.click("#ask-release button")
        until(lambda: page.is_visible("#revoke"))
        assert "Released by Ada" in page.inner_text("#release")
        assert wait_for_drive(api, held)["state"] == "done"
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_dashboard_asks_for_the_key_where_the_server_wants_one(browser: Any, tmp_path: Path) -> None:
    key = "correct horse battery"
    with service(tmp_path / "data", WAYLOOM_API_KEY=key) as up:
        page = browser.new_page()
        page.goto(up.url)
        page.wait_for_selector("#ask-key[open]")
        page.fill("#key", key)
        page.click("#ask-key button")
        until(lambda: page.inner_text("#live") == "live")
        page.close()
