"""What operators do from the pages: cancel, try again, from a stage, process anew with other settings, delete by typing a name."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.browsers import watched
from service_kit.little_stages import held_up
from service_kit.packed_drives import packed_drive
from service_kit.running import Up, service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with service(tmp_path_factory.mktemp("service") / "data") as running:
        yield running


@pytest.mark.browser
def test_a_drive_is_cancelled_and_tried_again_from_its_card(browser: Any, up: Up, tmp_path: Path) -> None:
    play: dict[str, object] = {"odometry": {"seconds": 20.0}}
    slow = upload(up.api(), packed_drive(tmp_path / "a", "slow street", play))["id"]
    with watched(browser, up.url) as page:
        card = page.locator(f"[data-id='{slow}']")
        until(lambda: "odometry" in card.locator(".words").inner_text())
        card.locator("[data-action=cancel]").click()
        until(lambda: "odometry: cancelled" in card.locator(".error").inner_text())
        card.locator("[data-action=retry]").click()
        page.wait_for_selector(f"[data-id='{slow}'][data-state=running]")
        until(lambda: "odometry" in card.locator(".words").inner_text())
        card.locator("[data-action=cancel]").click()
        page.wait_for_selector(f"[data-id='{slow}'][data-state=failed]")
    history = up.api().json("GET", f"/v1/drives/{slow}/history")["events"]
    assert [one["what"] for one in reversed(history) if one["stage"] == "odometry"] == [
        "begun", "cancelled", "asked", "begun", "cancelled",
    ]  # fmt: skip


@pytest.mark.browser
def test_a_failed_drive_is_begun_again_from_a_stage_and_its_log_tells_every_attempt(browser: Any, up: Up, tmp_path: Path) -> None:
    play: dict[str, object] = {"segmentation": {"fail": 3}}
    drive = upload(up.api(), packed_drive(tmp_path / "b", "unlucky street", play))["id"]
    wait_for_drive(up.api(), drive)
    with watched(browser, up.url, f"/drives/{drive}") as page:
        page.wait_for_selector("#history table")
        told = page.locator("#history .what").all_inner_texts()
        assert told.count("failed, is tried again") == 2
        assert told[0] == "failed"
        assert "RuntimeError: no luck this time" in page.inner_text("#history")
        page.click("#retry-from")
        assert page.evaluate("document.querySelector('dialog select').value") == "segmentation"
        page.select_option("dialog select", "odometry")
        with held_up(up.data, "odometry"):
            page.click("dialog .primary")
            until(lambda: page.inner_text("#state") != "failed")
        until(lambda: page.inner_text("#state") == "failed", 60)
        until(lambda: "this stage and those after it are made anew" in page.inner_text("#history"))


@pytest.mark.browser
def test_a_drive_is_processed_anew_with_other_settings_and_refusals_are_told_in_the_dialog(
    browser: Any, up: Up, tmp_path: Path
) -> None:
    drive = upload(up.api(), packed_drive(tmp_path / "c", "good street"))["id"]
    wait_for_drive(up.api(), drive)
    with watched(browser, up.url, f"/drives/{drive}") as page:
        page.click("#reprocess")
        page.fill("dialog textarea[name=labelling]", "no equals sign")
        page.click("dialog .primary")
        until(lambda: page.is_visible("dialog .error"))
        assert "not of the form key = value" in page.inner_text("dialog .error")
        page.fill("dialog textarea[name=labelling]", "between_keyframes = 0")
        with held_up(up.data, "stitch"):
            page.click("dialog .primary")
            page.wait_for_selector("#anew:not([hidden])")
        until(lambda: up.api().drive(drive)["reprocess"] is None)
    runs = up.api().json("GET", f"/v1/drives/{drive}/history")["events"]
    assert any("processed anew with {'labelling': {'between_keyframes': 0}}" in one["text"] for one in runs)


@pytest.mark.browser
def test_a_drive_is_deleted_by_typing_its_name_and_not_before(browser: Any, up: Up, tmp_path: Path) -> None:
    drive = upload(up.api(), packed_drive(tmp_path / "d", "old street"))["id"]
    wait_for_drive(up.api(), drive)
    with watched(browser, up.url) as page:
        card = page.locator(f"[data-id='{drive}']")
        card.locator("summary").click()
        card.locator("[data-action=delete]").click()
        assert page.is_disabled("dialog .danger")
        page.fill("dialog input", "old stree")
        assert page.is_disabled("dialog .danger")
        page.keyboard.press("Escape")
        page.wait_for_selector("dialog", state="detached")
        assert httpx2.get(f"{up.url}/v1/drives/{drive}").status_code == 200
        card.locator("summary").click()
        card.locator("[data-action=delete]").click()
        page.fill("dialog input", "old street")
        page.click("dialog .danger")
        card.wait_for(state="detached")
    until(lambda: httpx2.get(f"{up.url}/v1/drives/{drive}").status_code == 404)


@pytest.mark.browser
def test_the_page_of_a_drive_that_is_deleted_says_so_and_leads_back(browser: Any, up: Up, tmp_path: Path) -> None:
    drive = upload(up.api(), packed_drive(tmp_path / "e", "last street"))["id"]
    wait_for_drive(up.api(), drive)
    with watched(browser, up.url, f"/drives/{drive}") as page:
        page.click("#delete")
        page.fill("dialog input", "last street")
        page.click("dialog .danger")
        until(lambda: page.locator("h1:visible").all_inner_texts()[-1] == "This drive was removed")
        assert not page.is_visible("#problem")
        assert not page.is_visible("#history")
        page.click("#none a")
        page.wait_for_url(f"{up.url}/")


@pytest.mark.browser
def test_a_page_asks_nothing_more_about_a_drive_that_it_deletes(browser: Any, up: Up, tmp_path: Path) -> None:
    """A drive may be gone before the answer, and a browser complains of a 404."""
    drive = upload(up.api(), packed_drive(tmp_path / "f", "short street"))["id"]
    wait_for_drive(up.api(), drive)
    address = f"{up.url}/v1/drives/{drive}"

    def when_it_is_gone(route: Any) -> None:
        if route.request.method == "GET":
            until(lambda: httpx2.get(address).status_code == 404)
        route.continue_()

    with watched(browser, up.url, f"/drives/{drive}") as page:
        page.click("#delete")
        page.fill("dialog input", "short street")
        page.route(address, when_it_is_gone)
        page.click("dialog .danger")
        page.locator("h1", has_text="This drive was removed").wait_for()
