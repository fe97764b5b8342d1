"""The dashboard's pages when things do not go well: a session ends, the stream is away, answers fail."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
import pytest

from service_kit.browsers import RENEWED_S, answering, shot, without_stream
from service_kit.filled_service import Filled, change
from service_kit.guarded import PASSWORD, Guarded
from service_kit.running import until
from wayloom.config.roles import Role
from wayloom.store.database import Database
from wayloom.store.drives import get
from wayloom.store.jobs import create_map_job

PATHS = {"map": "/", "3d": "/3d", "drive": "/drives/{done}", "fleet": "/fleet", "areas": "/areas", "access": "/access"}
BEATS = {"map": ".head", "drive": "#main", "fleet": "#main", "areas": "#main", "3d": "#status"}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    service = Guarded(tmp_path_factory.mktemp("guarded") / "data")
    service.user("anna", Role.ADMIN)
    with closing(service):
        answering(service.api.url)
        yield service


def sign_in(page: Any, name: str = "anna") -> None:
    page.fill("#name", name)
    page.fill("#password", PASSWORD)
    page.click("#sign-in button")


@pytest.mark.browser
def test_every_page_leads_to_every_other(page: Any, filled: Filled) -> None:
    alone, ids = filled
    for name, path in PATHS.items():
        page.goto(alone.url + path.format(**ids))
        until(lambda: page.locator("nav a:visible").count() == 5)
        assert page.locator("nav a").all_inner_texts() == ["Map", "3D", "Fleet", "Areas", "Access"], name


@pytest.mark.browser
@pytest.mark.parametrize(("address", "status"), [("/drives/nonsense", 404), (f"/drives/{'0' * 64}", 200)])
def test_an_address_of_no_drive_says_so_and_leads_to_the_list(page: Any, filled: Filled, address: str, status: int) -> None:
    alone, ids = filled
    answer = page.goto(alone.url + address)
    assert answer.status == status
    until(lambda: page.is_visible("#none"))
    assert page.inner_text("h1:visible") == "There is no such drive"
    assert page.title() == "No such drive · wayloom"
    assert not page.is_visible("#history")
    assert page.locator("nav a:visible").count() == 5
    page.click("#none a")
    page.wait_for_selector(f"[data-id='{ids['done']}']")


@pytest.mark.browser
def test_an_unknown_page_says_so_with_the_status_404_and_leads_to_the_map(page: Any, filled: Filled) -> None:
    alone, _ = filled
    for path in ("/nonsense", "/drives/", "/drives/a/b"):
        assert page.goto(alone.url + path).status == 404, path
        assert page.inner_text("h1") == "There is no such page"
    page.click("main a")
    page.wait_for_url(f"{alone.url}/")


@pytest.mark.browser
def test_who_has_to_sign_in_comes_back_to_the_same_view(browser: Any, guarded: Guarded) -> None:
    context = browser.new_context()
    page = context.new_page()
    view = "/3d?of=all#at=8.4,49&colour=height"
    page.goto(guarded.api.url + view)
    page.wait_for_url("**/sign-in?next=*")
    assert unquote(page.url.partition("next=")[2]) == view
    sign_in(page)
    page.wait_for_url(f"{guarded.api.url}{view}")
    context.close()


@pytest.mark.browser
def test_a_sign_in_before_the_page_is_ready_is_not_sent_by_the_browser_itself(browser: Any, guarded: Guarded) -> None:
    context = browser.new_context()
    page = context.new_page()
    held: list[Any] = []
    page.route("**/sign-in.js", lambda route: held.append(route))
    page.goto(f"{guarded.api.url}/sign-in?next=%2Ffleet", wait_until="commit")
    page.fill("#name", "anna")
    page.fill("#password", PASSWORD)
    page.press("#password", "Enter")
    assert page.is_disabled("#sign-in button")
    until(lambda: bool(held))
    held[0].continue_()
    page.click("#sign-in button")
    page.wait_for_url(f"{guarded.api.url}/fleet")
    context.close()


@pytest.mark.browser
def test_a_session_that_ends_while_a_page_is_open_leads_to_the_sign_in_and_back(browser: Any, guarded: Guarded) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{guarded.api.url}/sign-in?next=%2Faccess")
    sign_in(page)
    page.wait_for_selector("#audit table")
    assert (
        page.evaluate(
            "fetch('/v1/session', { method: 'DELETE', headers: { 'X-Requested-With': 'wayloom' } }).then((one) => one.status)"
        )
        == 204
    )
    page.click("#audit-filter button")
    page.wait_for_url("**/sign-in?next=%2Faccess")
    context.close()


@pytest.mark.browser
@pytest.mark.parametrize(
    "wanted",
    ["//evil.example/", "https://evil.example/x", "/\\evil.example", "javascript:alert(1)", "http://", "/sign-in?next=%2F"],
)
def test_the_sign_in_leads_to_pages_of_this_service_alone(browser: Any, guarded: Guarded, wanted: str) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{guarded.api.url}/sign-in?next={quote(wanted, safe='')}")
    sign_in(page)
    page.wait_for_url(f"{guarded.api.url}/")
    context.close()


@pytest.mark.browser
def test_blocks_say_whether_they_are_live_and_the_list_comes_anew_after_the_service_was_away(page: Any, filled: Filled) -> None:
    alone, ids = filled
    page.goto(alone.url)
    page.wait_for_selector(f"[data-id='{ids['queued']}']")
    beat = page.locator("aside [data-live]")
    until(lambda: beat.get_attribute("aria-label") == "The list: live")
    alone.kill()
    until(lambda: "the service does not answer" in beat.get_attribute("aria-label"))
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with closing(database), database.write() as session:
        session.delete(get(session, ids["queued"]))  # of which no event tells
    alone.start()
    until(lambda: beat.get_attribute("aria-label") == "The list: live", 40)
    page.wait_for_selector(f"[data-id='{ids['queued']}']", state="detached")


@pytest.mark.browser
@pytest.mark.parametrize("name", BEATS)
def test_blocks_of_every_page_are_live(page: Any, filled: Filled, name: str) -> None:
    alone, ids = filled
    page.goto(alone.url + PATHS[name].format(**ids))
    beats = page.locator(f"{BEATS[name]} [data-live]")
    until(lambda: {one.get_attribute("data-live") for one in beats.all()} == {"live"})


@pytest.mark.browser
def test_drives_at_work_are_asked_for_every_ten_seconds_and_after_each_action(page: Any, filled: Filled) -> None:
    alone, ids = filled
    without_stream(page)
    page.goto(alone.url)
    page.wait_for_selector(f"[data-id='{ids['running']}'][data-state=running]")
    change(alone, ids["running"], state="failed", error="odometry: frame 12 is black")
    page.wait_for_selector(f"[data-id='{ids['running']}'][data-state=failed]", timeout=1000 * RENEWED_S)
    for state in ("running", "queued", "stitching"):
        change(alone, ids[state], state="done")
    until(lambda: "in work" not in page.inner_text("#count"), RENEWED_S)
    card = page.locator(f"[data-id='{ids['held']}']")
    card.locator("summary").click()
    card.locator("[data-action=delete]").click()
    page.fill("dialog input", "street held")
    page.click("dialog .danger")
    until(lambda: card.count() == 0 or card.get_attribute("data-state") == "removing", 5)


@pytest.mark.browser
def test_the_fleet_page_takes_its_complaint_back_and_tells_what_the_map_s_jobs_did(page: Any, filled: Filled) -> None:
    alone, _ = filled
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with closing(database), database.write() as session:
        job = create_map_job(session, "stitch", "city")
        job.state, job.started_at, job.finished_at, job.error = "failed", job.created_at, job.created_at + 75.0, "no memory"
    page.route("**/v1/fleet", lambda route: route.fulfill(status=503, json={"detail": "the database is away"}))
    page.goto(f"{alone.url}/fleet")
    until(lambda: page.is_visible("#problem") and page.inner_text("#problem") == "the database is away")
    page.unroute("**/v1/fleet")
    until(lambda: not page.is_visible("#problem"), RENEWED_S)
    cells = page.locator("#map-jobs tbody tr").first.locator("td").all_inner_texts()
    assert [cells[1], cells[2], cells[4], cells[5]] == ["stitch", "failed", "1 min 15 s", "no memory"]


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_table_that_goes_on_beyond_its_edge_has_a_shade_there(browser: Any, filled: Filled, scheme: str) -> None:
    alone, _ = filled
    page = browser.new_page(viewport={"width": 390, "height": 900}, color_scheme=scheme)
    page.goto(f"{alone.url}/fleet")
    page.wait_for_selector("#vehicles table")
    assert page.evaluate("document.querySelector('#vehicles').scrollWidth > document.querySelector('#vehicles').clientWidth + 60")
    left, right = edges(page, "#vehicles")
    assert right > left + 8
    page.evaluate("document.querySelector('#vehicles').scrollLeft = 30")
    left, right = edges(page, "#vehicles")
    assert min(left, right) > 8
    page.evaluate("document.querySelector('#vehicles').scrollLeft = 9999")
    left, right = edges(page, "#vehicles")
    assert left > right + 8
    page.close()


def edges(page: Any, selector: str) -> tuple[int, int]:
    """How much darker than the panel most rows of a block are at its left and at its right edge, 0 to 255."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    x, y, width, height = (int(box[name]) for name in ("x", "y", "width", "height"))
    picture = shot(page)[y + 2 : y + height - 2].astype(int).mean(axis=2)
    ground = np.median(picture[:, x - 4])
    left, right = (int(ground - np.median(picture[:, at])) for at in (x + 1, x + width - 2))
    return left, right
