"""The page of one drive: what it says of the drive in every state, its pictures and downloads, and how it lets the drive go."""

from typing import Any

import pytest

from service_kit.browsers import RENEWED_S, without_stream
from service_kit.filled_service import Filled, change
from service_kit.running import until

PICTURES = "**/keyframes/*/points.webp"


@pytest.mark.browser
def test_a_drive_at_work_is_asked_for_on_its_page_too_and_the_focus_stays(page: Any, filled: Filled) -> None:
    alone, ids = filled
    without_stream(page)
    page.goto(f"{alone.url}/drives/{ids['running']}")
    until(lambda: page.inner_text("#state") == "working")
    page.focus("#delete")
    change(alone, ids["running"], state="failed", error="odometry: frame 12 is black", placed=True)
    until(lambda: page.inner_text("#state") == "failed", RENEWED_S)
    assert page.evaluate("document.activeElement.id") == "delete"
    assert page.is_visible("#downloads a")  # they were drawn anew


@pytest.mark.browser
def test_the_page_of_a_held_drive_says_why_and_what_an_operator_can_do(page: Any, filled: Filled) -> None:
    alone, ids = filled
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
def test_durations_have_seconds_below_ten_minutes_and_hours_from_sixty(page: Any, filled: Filled) -> None:
    alone, ids = filled
    told = {
        0.2: "1 s", 59.4: "59 s", 59.6: "1 min", 91: "1 min 31 s", 180: "3 min", 599.4: "9 min 59 s", 599.6: "10 min",
        754: "13 min", 3569: "59 min", 3570: "1 h", 3599: "1 h", 5400: "1 h 30 min", 7200: "2 h", 90_120: "25 h 2 min",
    }  # fmt: skip
    page.goto(f"{alone.url}/drives/{ids['done']}")
    words = "async (all) => all.map((await import('/static/ui/words.js')).duration)"
    assert page.evaluate(words, [*told]) == [*told.values()]
    until(lambda: "300 stereo pairs in 30 s" in page.inner_text("#numbers"))


@pytest.mark.browser
def test_the_verdict_on_a_drive_is_said_in_words(page: Any, filled: Filled) -> None:
    alone, ids = filled
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
def test_a_download_that_is_refused_is_said_and_not_saved(page: Any, filled: Filled) -> None:
    alone, ids = filled
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
def test_plots_name_the_mark_of_the_keyframe_and_the_bands_of_bursts(page: Any, filled: Filled) -> None:
    alone, ids = filled
    page.goto(f"{alone.url}/drives/{ids['done']}")
    page.wait_for_selector("#picture img")
    page.focus("#keyframe")
    page.keyboard.press("Home")
    names = page.locator("#track figcaption span:visible")
    until(lambda: "keyframe that is shown" in [one.strip() for one in names.all_inner_texts()])
    told = [one.strip() for one in page.locator("[data-plot=speed] figcaption span:visible").all_inner_texts()]
    assert told == ["speed by the odometry", "GNSS burst"]


@pytest.mark.browser
def test_the_poses_of_a_drive_without_a_place_are_said_to_be_in_its_own_frame(page: Any, filled: Filled) -> None:
    alone, ids = filled
    poses = page.locator("#downloads li", has_text="TUM")
    page.goto(f"{alone.url}/drives/{ids['done']}")
    until(lambda: poses.count() and poses.inner_text() == "Keyframe poses, TUM East, north, up in the map's frame")
    change(alone, ids["done"], placed=False)
    page.reload()
    own = "Keyframe poses, TUM Right, ahead, up of the drive's start: it has no place on Earth"
    until(lambda: poses.count() and poses.inner_text() == own)


@pytest.mark.browser
def test_a_picture_of_a_keyframe_that_comes_late_is_not_shown(page: Any, filled: Filled) -> None:
    """Asked for before another one was, it would stand under the other one's words."""
    alone, ids = filled
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


def ask_for_deletion(page: Any, address: str) -> None:
    """The page of the drive `street done`, whose picture does not come, with the dialog that deletes it."""
    with page.expect_request(PICTURES):
        page.route(PICTURES, lambda route: None)
        page.goto(address)
    page.click("#delete")
    page.fill("dialog input", "street done")


@pytest.mark.browser
def test_a_picture_of_a_drive_that_is_deleted_is_not_waited_for(page: Any, filled: Filled) -> None:
    alone, ids = filled
    ask_for_deletion(page, f"{alone.url}/drives/{ids['done']}")
    with page.expect_event("requestfailed") as given_up:
        page.click("dialog .danger")
    assert "/keyframes/" in given_up.value.url
    until(lambda: page.inner_text("#state") == "being removed")
    assert not page.is_visible("#problem")


@pytest.mark.browser
def test_a_page_knows_without_the_stream_that_its_drive_goes_and_that_it_is_gone(page: Any, filled: Filled) -> None:
    """The stream of events tells of the newest drives alone."""
    alone, ids = filled
    without_stream(page)
    page.clock.install()
    ask_for_deletion(page, f"{alone.url}/drives/{ids['done']}")
    page.click("dialog .danger")
    until(lambda: page.inner_text("#state") == "being removed")
    asked: list[Any] = []
    page.route(f"**/v1/drives/{ids['done']}", lambda route: asked.append(route))
    page.clock.fast_forward("00:30")
    page.evaluate("async () => (await fetch('/healthz')).text()")  # what the page asked before is told by then
    assert asked == []
    page.clock.fast_forward("00:31")
    until(lambda: page.evaluate("true") and asked)
    asked[0].fulfill(status=404, json={"detail": "no such drive"})
    page.locator("h1", has_text="This drive was removed").wait_for()


@pytest.mark.browser
def test_what_tells_of_changes_is_not_given_up_with_the_rest(page: Any, filled: Filled) -> None:
    """Where there is no stream the lists are asked for, and a page that deletes its drive is not offline for that."""
    alone, ids = filled
    lists: list[Any] = []
    given_up: list[str] = []
    page.route("**/v1/events*", lambda route: route.fulfill(status=503, json={"detail": "busy"}))
    page.route("**/v1/drives?limit=200", lambda route: lists.append(route))
    page.on("requestfailed", lambda request: given_up.append(request.url))
    ask_for_deletion(page, f"{alone.url}/drives/{ids['done']}")
    until(lambda: page.evaluate("true") and lists)
    page.click("dialog .danger")
    until(lambda: page.inner_text("#state") == "being removed" and given_up)
    assert all("/keyframes/" in url for url in given_up)
    lists[0].continue_()
    until(lambda: page.inner_text("#live") == "polling")


@pytest.mark.browser
def test_a_page_whose_drive_is_not_deleted_after_all_shows_it_again(page: Any, filled: Filled) -> None:
    alone, ids = filled

    def refuse_deletion(route: Any) -> None:
        if route.request.method == "DELETE":
            route.fulfill(status=409, json={"detail": "not now"})
        else:
            route.continue_()

    ask_for_deletion(page, f"{alone.url}/drives/{ids['done']}")
    page.route(f"**/v1/drives/{ids['done']}", refuse_deletion)
    page.unroute(PICTURES)
    page.click("dialog .danger")
    page.locator("dialog .error", has_text="not now").wait_for()
    page.wait_for_selector("#picture img")
    assert not page.is_visible("#problem")
