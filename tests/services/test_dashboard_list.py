"""The list of drives in a real browser: a page of many, filtered, searched, sorted; by mouse, keys and screen reader."""

import hashlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.browsers import watched
from service_kit.guarded import PASSWORD, Guarded
from service_kit.packed_drives import packed_drive
from service_kit.running import ApiAlone, service, until
from wayloom.client.upload import upload
from wayloom.config.roles import Role
from wayloom.store.database import Database
from wayloom.store.drives import get

MANY = 130
UPLOAD_PANEL = "/upload/panel.js"


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    """A service that many drives were announced to; one of them has failed, one disagrees with its GNSS by 3 %."""
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data")
    with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
        ids = [announce(http, f"drive {number:03}", f"van-{number % 3}") for number in range(MANY)]
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with database.write() as session:
        failed, doubted = get(session, ids[5]), get(session, ids[6])
        failed.state, failed.error = "failed", "odometry: frame 12 is black"
        doubted.state, doubted.placed, doubted.grade, doubted.gate, doubted.reasons = "done", True, "A", "merge", ["sigma 0.03 m"]
        doubted.facts = {"georeference": {"scale": {"mean": 1.031, "sigma": 0.001}, "messages": []}}
    database.close()
    yield alone
    alone.close()


def announce(http: httpx2.Client, name: str, vehicle: str) -> str:
    file = {"path": "log/a", "size": 10, "sha256": hashlib.sha256(name.encode()).hexdigest()}
    return str(http.post("/v1/drives", json={"name": name, "vehicle_id": vehicle, "files": [file]}).json()["id"])


def names(page: Any) -> list[str]:
    return list(page.locator("#drives .name").all_inner_texts())


@pytest.mark.browser
def test_of_many_drives_the_page_holds_one_page_and_turns_it(browser: Any, full: ApiAlone) -> None:
    with watched(browser, full.url) as page:
        page.wait_for_selector("#drives .drive")
        assert len(names(page)) == 40
        assert page.inner_text("#shown") == f"1–40 of {MANY} drives"
        assert names(page)[0] == f"drive {MANY - 1:03}"
        for first in (41, 81, 121):
            page.click("#earlier")
            until(lambda first=first: page.inner_text("#shown").startswith(f"{first}–"))
        assert len(names(page)) == MANY - 120
        assert page.is_disabled("#earlier")
        page.click("#later")
        until(lambda: page.inner_text("#shown").startswith("81–"))


@pytest.mark.browser
def test_drives_are_searched_filtered_and_sorted_by_the_server(browser: Any, full: ApiAlone) -> None:
    with watched(browser, full.url) as page:
        page.wait_for_selector("#drives .drive")
        page.fill("#search", "drive 01")
        until(lambda: len(names(page)) == 10)
        page.select_option("#sort", "oldest")
        until(lambda: names(page)[0] == "drive 010")
        page.focus("#filter-vehicle")
        until(lambda: page.locator("#filter-vehicle option").count() == 4)
        page.select_option("#filter-vehicle", "van-1")
        until(lambda: names(page) == ["drive 010", "drive 013", "drive 016", "drive 019"])
        page.fill("#search", "")
        page.select_option("#filter-vehicle", "")
        page.select_option("#filter-state", "failed")
        until(lambda: names(page) == ["drive 005"])
        assert page.inner_text("#drives .error") == "odometry: frame 12 is black"
        page.fill("#search", "no such drive")
        until(lambda: page.is_visible("#none"))


@pytest.mark.browser
def test_what_is_doubtful_about_a_drive_is_said_loudly_on_its_card(browser: Any, full: ApiAlone) -> None:
    with watched(browser, full.url) as page:
        page.fill("#search", "drive 006")
        until(lambda: names(page) == ["drive 006"])
        said = page.inner_text("#drives .warnings")
        assert "odometry and GNSS disagree on the length of the drive by +3.1 %" in said
        assert "the rig's calibration or the fixes are wrong" in said


@pytest.mark.browser
def test_cards_are_reached_and_used_by_keys_with_a_focus_that_is_seen(browser: Any, full: ApiAlone) -> None:
    with watched(browser, full.url) as page:
        page.fill("#search", "drive 006")
        until(lambda: names(page) == ["drive 006"])
        page.focus("#sort")
        reached = []
        for _ in range(4):
            page.keyboard.press("Tab")
            reached.append(page.evaluate("document.activeElement.ariaLabel ?? document.activeElement.textContent"))
        assert reached == ["drive 006", "Show drive 006 on the map", "Details of drive 006", "More actions: drive 006"]
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        page.keyboard.press("Enter")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.ariaLabel") == "Process anew: drive 006"
        page.focus("#drives .show")
        page.keyboard.press("Enter")
        assert page.get_attribute("#drives .show", "aria-pressed") == "true"
        page.focus("#drives .report")
        page.keyboard.press("Enter")
        page.wait_for_url("**/drives/*")


@pytest.mark.browser
def test_a_change_of_a_drive_is_told_to_who_does_not_see_it_and_its_time_is_guessed_from_the_first_on(
    browser: Any, tmp_path: Path
) -> None:
    with service(tmp_path / "data") as up, watched(browser, up.url) as page:
        until(lambda: page.inner_text("#live") == "live")
        assert page.is_visible("#no-map")
        assert "drop a drive's folder" in page.inner_text("#no-map")
        play: dict[str, object] = {"odometry": {"seconds": 4.0}}
        slow = upload(up.api(), packed_drive(tmp_path / "a", "slow drive", play))["id"]
        page.wait_for_selector(f"[data-id='{slow}'][data-state=running]")
        until(lambda: "roughly" in page.inner_text(f"[data-id='{slow}'] .words"))  # stages were never seen here
        page.wait_for_selector(f"[data-id='{slow}'][data-state=done]")
        until(lambda: page.inner_text("#said") == "slow drive: in the map")
        assert page.get_attribute("#said", "aria-live") == "polite"
        assert not page.is_visible("#no-map")


@pytest.mark.browser
def test_a_service_that_is_away_is_said_and_the_page_recovers_by_itself(browser: Any, tmp_path: Path) -> None:
    with closing(ApiAlone(tmp_path / "data")) as alone:
        page = browser.new_page()
        page.goto(alone.url)
        until(lambda: page.inner_text("#live") == "live")
        alone.kill()
        until(lambda: page.is_visible("#away"))
        assert "The service does not answer. Shown is what was known at" in page.inner_text("#away")
        alone.start()
        until(lambda: page.inner_text("#live") == "live", 40)
        assert not page.is_visible("#away")
        page.close()


@pytest.mark.browser
def test_viewers_see_drives_without_any_action_and_no_page_of_admins(browser: Any, tmp_path: Path) -> None:
    guarded = Guarded(tmp_path / "data")
    guarded.user("vera", Role.VIEWER)
    guarded.user("otto", Role.OPERATOR)
    with closing(guarded):
        drive = guarded.drive(guarded.key(Role.OPERATOR))
        found = {}
        for name in ("vera", "otto"):
            context = browser.new_context()
            page = context.new_page()
            asked: list[str] = []
            page.on("request", lambda request, asked=asked: asked.append(request.url))
            page.goto(f"{guarded.api.url}/sign-in")
            page.fill("#name", name)
            page.fill("#password", PASSWORD)
            page.click("#sign-in button")
            page.wait_for_selector(f"[data-id='{drive}']")
            # By the time that it hears of changes, the page has asked for what uploads; the button is there when that has come.
            page.wait_for_selector("#live.good")
            sends = any(url.endswith(UPLOAD_PANEL) for url in asked)
            if sends:
                page.wait_for_selector("#send")
            found[name] = {
                "actions": page.locator(".acts button").evaluate_all("(all) => all.map((one) => one.dataset.action)"),
                "sends": sends,
                "send": page.is_visible("#send"),
                "pages": page.locator("nav a:visible").all_inner_texts(),
            }
            context.close()
        assert found["vera"] == {"actions": [], "sends": False, "send": False, "pages": ["Map", "3D", "Fleet", "Areas"]}
        assert found["otto"] == {"actions": ["delete"], "sends": True, "send": True, "pages": ["Map", "3D", "Fleet", "Areas"]}
