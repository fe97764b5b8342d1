"""The dashboard's pages when things do not go well: a session ends, the stream is away, answers fail or come late."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
import pytest

from service_kit.browsers import answering, shot
from service_kit.filled_service import filled
from service_kit.guarded import API_KEY, PASSWORD, Guarded
from service_kit.running import ApiAlone, until
from wayloom.config.roles import Role
from wayloom.store.database import Database
from wayloom.store.drives import get
from wayloom.store.jobs import create_map_job

PATHS = {"map": "/", "3d": "/3d", "drive": "/drives/{done}", "fleet": "/fleet", "areas": "/areas", "access": "/access"}
BEATS = {"map": ".head", "drive": "#main", "fleet": "#main", "areas": "#main", "3d": "#status"}
RENEWED_S = 20.0
"""Pages ask again after 10 s."""


@pytest.fixture
def shown(tmp_path: Path) -> Iterator[tuple[ApiAlone, dict[str, str]]]:
    """A service with something on every page, and its drives by their states."""
    alone, ids = filled(tmp_path / "data")
    with closing(alone):
        yield alone, ids


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


def change(alone: ApiAlone, drive_id: str, **values: Any) -> None:
    """A drive's row, as a worker would change it."""
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with closing(database), database.write() as session:
        row = get(session, drive_id)
        for name, value in values.items():
            setattr(row, name, value)


def without_stream(page: Any) -> None:
    """Events never come: what changes, the page has to ask for."""
    page.route("**/v1/events*", lambda route: None)


@pytest.mark.browser
def test_every_page_leads_to_every_other(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    answering(alone.url)
    for name, path in PATHS.items():
        page.goto(alone.url + path.format(**ids))
        until(lambda: page.locator("nav a:visible").count() == 5)
        assert page.locator("nav a").all_inner_texts() == ["Map", "3D", "Fleet", "Areas", "Access"], name


@pytest.mark.browser
@pytest.mark.parametrize(("address", "status"), [("/drives/nonsense", 404), (f"/drives/{'0' * 64}", 200)])
def test_an_address_of_no_drive_says_so_and_leads_to_the_list(
    page: Any, shown: tuple[ApiAlone, dict[str, str]], address: str, status: int
) -> None:
    alone, ids = shown
    answering(alone.url)
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
def test_an_unknown_page_says_so_with_the_status_404_and_leads_to_the_map(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, _ = shown
    answering(alone.url)
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
def test_blocks_say_whether_they_are_live_and_the_list_comes_anew_after_the_service_was_away(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, ids = shown
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
def test_blocks_of_every_page_are_live(page: Any, shown: tuple[ApiAlone, dict[str, str]], name: str) -> None:
    alone, ids = shown
    answering(alone.url)
    page.goto(alone.url + PATHS[name].format(**ids))
    beats = page.locator(f"{BEATS[name]} [data-live]")
    until(lambda: {one.get_attribute("data-live") for one in beats.all()} == {"live"})


@pytest.mark.browser
def test_drives_at_work_are_asked_for_every_ten_seconds_and_after_each_action(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, ids = shown
    answering(alone.url)
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
def test_a_drive_at_work_is_asked_for_on_its_page_too_and_the_focus_stays(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, ids = shown
    answering(alone.url)
    without_stream(page)
    page.goto(f"{alone.url}/drives/{ids['running']}")
    until(lambda: page.inner_text("#state") == "working")
    page.focus("#delete")
    change(alone, ids["running"], state="failed", error="odometry: frame 12 is black", placed=True)
    until(lambda: page.inner_text("#state") == "failed", RENEWED_S)
    assert page.evaluate("document.activeElement.id") == "delete"
    assert page.is_visible("#downloads a")  # they were drawn anew


@pytest.mark.browser
def test_the_page_of_a_held_drive_says_why_and_what_an_operator_can_do(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    answering(alone.url)
    ways = page.locator("#ways-out li")
    page.goto(f"{alone.url}/drives/{ids['held']}")
    until(lambda: ways.count() == 3)
    assert page.inner_text("#reasons") == "sigma of the position 2.00 m in the median"
    assert [one.split()[0] for one in ways.all_inner_texts()] == ["Release", "Process", "Delete"]
    assert all(page.is_visible(f"#{name}") for name in ("ask-release", "reprocess", "delete"))
    change(alone, ids["held"], placed=False, images="deleted", sound=True)
    page.reload()
    until(lambda: ways.count() == 3 and "cannot be released: send it again with GNSS" in ways.first.inner_text())
    said = ways.all_inner_texts()
    assert "wayloom upload LOG --again" in said[1]
    assert said[2].startswith("Delete")
    assert not page.is_visible("#ask-release")
    change(alone, ids["quarantined"], gate="hold", sound=True)
    page.goto(f"{alone.url}/drives/{ids['quarantined']}")
    until(lambda: ways.count() == 4)
    assert ways.first.inner_text() == "Wait: drives that come later and meet it may place it."
    page.goto(f"{alone.url}/drives/{ids['done']}")
    page.wait_for_selector("#verdict:visible")
    assert not page.is_visible("#ways")


@pytest.mark.browser
def test_a_viewer_is_told_who_may_do_something_about_a_held_drive(browser: Any, guarded: Guarded) -> None:
    guarded.user("vera", Role.VIEWER)
    drive = guarded.drive(API_KEY)
    change(guarded.api, drive, state="held", grade="D", gate="hold", reasons=["sigma 2.00 m"], placed=True)
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{guarded.api.url}/sign-in?next=%2Fdrives%2F{drive}")
    sign_in(page, "vera")
    page.wait_for_selector("#ways-out li")
    assert page.inner_text("#ways-out") == (
        "An operator may release it into the map, process it anew with other settings or delete it. You may look at it."
    )
    assert not page.is_visible("#ask-release")
    context.close()


@pytest.mark.browser
def test_the_fleet_page_takes_its_complaint_back_and_tells_what_the_map_s_jobs_did(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, _ = shown
    database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    with closing(database), database.write() as session:
        job = create_map_job(session, "stitch", "city")
        job.state, job.started_at, job.finished_at, job.error = "failed", job.created_at, job.created_at + 75.0, "no memory"
    answering(alone.url)
    page.route("**/v1/fleet", lambda route: route.fulfill(status=503, json={"detail": "the database is away"}), times=1)
    page.goto(f"{alone.url}/fleet")
    until(lambda: page.is_visible("#problem") and page.inner_text("#problem") == "the database is away")
    until(lambda: not page.is_visible("#problem"), RENEWED_S)
    cells = page.locator("#map-jobs tbody tr").first.locator("td").all_inner_texts()
    assert [cells[1], cells[2], cells[4], cells[5]] == ["stitch", "failed", "1 min 15 s", "no memory"]


@pytest.mark.browser
def test_durations_have_seconds_below_ten_minutes_and_hours_from_sixty(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    told = {
        0.2: "1 s", 59.4: "59 s", 59.6: "1 min", 91: "1 min 31 s", 180: "3 min", 599.4: "9 min 59 s", 599.6: "10 min",
        754: "13 min", 3569: "59 min", 3570: "1 h", 3599: "1 h", 5400: "1 h 30 min", 7200: "2 h", 90_120: "25 h 2 min",
    }  # fmt: skip
    answering(alone.url)
    page.goto(f"{alone.url}/drives/{ids['done']}")
    words = "async (all) => all.map((await import('/static/ui/words.js')).duration)"
    assert page.evaluate(words, [*told]) == [*told.values()]
    until(lambda: "300 stereo pairs in 30 s" in page.inner_text("#numbers"))


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_table_that_goes_on_beyond_its_edge_has_a_shade_there(
    browser: Any, shown: tuple[ApiAlone, dict[str, str]], scheme: str
) -> None:
    alone, _ = shown
    answering(alone.url)
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


@pytest.mark.browser
def test_the_verdict_on_a_drive_is_said_in_words(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    answering(alone.url)
    for state, words in {
        "done": "Grade B by its own GNSS, merged into the map",
        "held": "Grade D by its own GNSS, held: it waits for drives that place it, or an operator",
        "quarantined": "Grade D by its own GNSS, quarantined: not merged",
    }.items():
        page.goto(f"{alone.url}/drives/{ids[state]}")
        until(lambda words=words: page.inner_text("#verdict") == words)
    words = "async (drive) => (await import('/static/drive/verdict.js')).verdict(drive)"
    merged = {"grade": "A", "gate": "merge", "release": None, "by_map": None}
    assert page.evaluate(words, {"state": "failed", "quality": merged}) == "Grade A by its own GNSS, good enough for the map"
    held = {"grade": None, "gate": "hold", "release": {"by": "Ada"}, "by_map": None}
    assert page.evaluate(words, {"state": "done", "quality": held}) == "No GNSS of its own, released"
    met = {"grade": "D", "gate": "hold", "release": None, "by_map": {"admitted": True, "grade": "B"}}
    said = page.evaluate(words, {"state": "done", "quality": met})
    assert said == "Grade D by its own GNSS, in the map with grade B by the drives that it meets"


@pytest.mark.browser
def test_a_download_that_is_refused_is_said_and_not_saved(page: Any, tmp_path: Path) -> None:
    alone, ids = filled(tmp_path / "data")
    with closing(alone):
        answering(alone.url)
        page.add_init_script("sessionStorage.setItem('wayloom-key', 'any')")  # where a link sends no key, the page fetches
        downloads: list[Any] = []
        page.on("download", lambda one: downloads.append(one))
        page.route("**/cloud.ply", lambda route: route.fulfill(status=404, json={"detail": "its points are gone"}))
        page.goto(f"{alone.url}/drives/{ids['done']}")
        link = page.locator("#downloads a", has_text="PLY")
        link.click()
        until(lambda: page.is_visible("#problem") and page.inner_text("#problem") == "its points are gone")
        assert downloads == []
        assert page.evaluate("document.activeElement.textContent") == "Labelled points, PLY"
        with page.expect_download() as found:
            page.locator("#downloads a", has_text="GeoJSON").click()
        assert found.value.suggested_filename == "street done.geojson"


@pytest.mark.browser
def test_plots_name_the_mark_of_the_keyframe_and_the_bands_of_bursts(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    answering(alone.url)
    page.goto(f"{alone.url}/drives/{ids['done']}")
    page.wait_for_selector("#picture img")
    page.focus("#keyframe")
    page.keyboard.press("Home")
    names = page.locator("#track figcaption span:visible")
    until(lambda: "keyframe that is shown" in [one.strip() for one in names.all_inner_texts()])
    told = [one.strip() for one in page.locator("[data-plot=speed] figcaption span:visible").all_inner_texts()]
    assert told == ["speed by the odometry", "GNSS burst"]


@pytest.mark.browser
def test_the_poses_of_a_drive_without_a_place_are_said_to_be_in_its_own_frame(
    page: Any, shown: tuple[ApiAlone, dict[str, str]]
) -> None:
    alone, ids = shown
    answering(alone.url)
    poses = page.locator("#downloads li", has_text="TUM")
    page.goto(f"{alone.url}/drives/{ids['done']}")
    until(lambda: poses.count() and poses.inner_text() == "Keyframe poses, TUM East, north, up in the map's frame")
    change(alone, ids["done"], placed=False)
    page.reload()
    own = "Keyframe poses, TUM Right, ahead, up of the drive's start: it has no place on Earth"
    until(lambda: poses.count() and poses.inner_text() == own)


@pytest.mark.browser
def test_a_picture_of_a_keyframe_that_comes_late_is_not_shown(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    """Asked for before another one was, it would stand under the other one's words."""
    alone, ids = shown
    answering(alone.url)
    late: list[Any] = []
    page.route("**/keyframes/0/points.webp", lambda route: late.append(route))
    page.goto(f"{alone.url}/drives/{ids['done']}")
    page.wait_for_selector("#picture img")
    last = int(page.get_attribute("#keyframe", "max"))
    assert last > 0
    page.focus("#keyframe")
    page.keyboard.press("Home")
    until(lambda: page.evaluate("true") and late)
    page.keyboard.press("End")
    words = f"of Keyframe {last + 1} of"
    until(lambda: words in page.get_attribute("#picture img", "alt"))
    late[0].continue_()
    page.wait_for_timeout(700)
    assert words in page.get_attribute("#picture img", "alt")


@pytest.mark.browser
def test_a_picture_of_a_drive_that_is_deleted_is_not_waited_for(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    """And that it goes is known by the answer: the stream of events tells of the newest drives alone."""
    alone, ids = shown
    answering(alone.url)
    held: list[Any] = []
    page.route("**/v1/events*", lambda route: held.append(route))
    with page.expect_request("**/keyframes/*/points.webp"):
        page.route("**/keyframes/*/points.webp", lambda route: held.append(route))
        page.goto(f"{alone.url}/drives/{ids['done']}")
    page.click("#delete")
    page.fill("dialog input", "street done")
    with page.expect_event("requestfailed") as given_up:
        page.click("dialog .danger")
    assert "/keyframes/" in given_up.value.url
    until(lambda: page.inner_text("#state") == "being removed")
    assert not page.is_visible("#problem")


@pytest.mark.browser
def test_a_page_whose_drive_is_not_deleted_after_all_shows_it_again(page: Any, shown: tuple[ApiAlone, dict[str, str]]) -> None:
    alone, ids = shown
    answering(alone.url)
    held: list[Any] = []

    def refuse_deletion(route: Any) -> None:
        if route.request.method == "DELETE":
            route.fulfill(status=409, json={"detail": "not now"})
        else:
            route.continue_()

    with page.expect_request("**/keyframes/*/points.webp"):
        page.route("**/keyframes/*/points.webp", lambda route: held.append(route))
        page.goto(f"{alone.url}/drives/{ids['done']}")
    page.route(f"**/v1/drives/{ids['done']}", refuse_deletion)
    page.click("#delete")
    page.fill("dialog input", "street done")
    page.unroute("**/keyframes/*/points.webp")
    page.click("dialog .danger")
    page.locator("dialog .error", has_text="not now").wait_for()
    page.wait_for_selector("#picture img")
    assert not page.is_visible("#problem")
