"""The 3D page in a real Chromium: its points are drawn, coloured and toggled as asked, picked with lineage, and flown along."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
import pytest

from service_kit.browsers import pixels_by_class, shot, tones
from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import ApiAlone, until
from tiles.made_maps import made_map

SETTLED = "!!globalThis.wayloom3d && wayloom3d.scene.isSettled && wayloom3d.scene.points > 0"
NO_WEBGL = """const of = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : of.call(this, kind, ...rest);
};"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    served = looked_at(tmp_path_factory.mktemp("view3d") / "data", parked=made_map(300, extent_m=60.0, seed=1))
    with closing(served.api):
        yield served


class Page:
    """An open page that says what went wrong on it."""

    def __init__(self, browser: Any, address: str, **how: Any) -> None:
        self.said: list[str] = []
        self.page = browser.new_page(viewport={"width": 900, "height": 700}, color_scheme="light", **how)
        self.page.on("console", lambda message: self.said.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.goto(address)

    def settled(self) -> Any:
        until(lambda: self.page.evaluate(SETTLED), 60)
        return self.page

    def close(self) -> None:
        self.page.close()
        assert self.said == []


@pytest.fixture
def opened(browser: Any, shown: LookedAt) -> Iterator[Any]:
    """Opens 3D pages with what is behind `#`; at the end none may have complained."""
    pages: list[Page] = []

    def open_(words: str = "") -> Any:
        pages.append(Page(browser, f"{shown.api.url}/3d#{words}"))
        return pages[-1].settled()

    yield open_
    for page in pages:
        page.close()


def canvas(page: Any) -> Any:
    """(h, w, 3) RGB of the picture, without panels."""
    return shot(page)[60:, 300:]


def drawn(page: Any) -> int:
    """Pixels that are not the background's."""
    picture = canvas(page).astype(int)
    return int((np.abs(picture - picture[-1, 5]).max(axis=2) > 12).sum())


@pytest.mark.browser
def test_every_voxel_is_there_from_near_and_a_coarser_level_from_afar(opened: Any, shown: LookedAt) -> None:
    page = opened()
    assert page.inner_text("#version") == "city · version 1"
    assert drawn(page) > 5000
    page.evaluate("wayloom3d.scene.detailPx = 0.01; wayloom3d.scene.redraw()")
    until(lambda: page.evaluate(SETTLED) and page.evaluate("wayloom3d.scene.points") == len(shown.city), 60)
    assert len({*page.evaluate("wayloom3d.scene.tiles().map((tile) => tile.address.href)")}) > 6
    page.evaluate("wayloom3d.scene.detailPx = 6; wayloom3d.scene.orbit.place({ distance: 20_000 })")
    top = "wayloom3d.scene.tiles().every((tile) => tile.address.pathname.includes('/cloud/12/'))"
    until(lambda: page.evaluate(SETTLED) and page.evaluate(top))
    assert page.evaluate("wayloom3d.scene.points") < 0.5 * len(shown.city)


@pytest.mark.browser
def test_colours_are_those_of_classes_and_change_with_the_mode(opened: Any) -> None:
    page = opened()
    palette = tones(page)
    by_class = pixels_by_class(canvas(page), palette)
    assert min(by_class[name] for name in ("road", "sidewalk", "building", "vegetation", "terrain")) > 50
    page.emulate_media(color_scheme="dark")
    until(lambda: pixels_by_class(canvas(page), tones(page, "dark"))["building"] > 0.5 * by_class["building"])
    page.emulate_media(color_scheme="light")
    until(lambda: pixels_by_class(canvas(page), palette) == by_class)
    pictures = {"class": canvas(page)}
    for mode in ("height", "drives", "age", "confidence"):
        page.select_option("#colour", mode)
        until(lambda mode=mode: page.evaluate(SETTLED) and f"colour={mode}" in page.url)
        assert page.is_visible("#ramp")
        pictures[mode] = canvas(page)
        assert pixels_by_class(pictures[mode], palette)["sidewalk"] < 0.1 * by_class["sidewalk"]
    assert "drives" in page.inner_text("#ramp-high") or page.inner_text("#ramp-high") == "100 % of votes"
    for one, other in (("height", "drives"), ("drives", "age"), ("age", "confidence"), ("height", "confidence")):
        assert (np.abs(pictures[one].astype(int) - pictures[other]).max(axis=2) > 30).sum() > 2000, (one, other)


@pytest.mark.browser
def test_age_goes_from_the_oldest_to_the_newest_day_that_a_drive_saw(opened: Any, shown: LookedAt) -> None:
    page = opened("colour=age")
    until(lambda: "-" in page.inner_text("#ramp-low"))
    days = np.datetime_as_string(shown.city.last_seen_ns.astype("datetime64[ns]"), unit="D")
    assert min(days)[:4] <= page.inner_text("#ramp-low")[:4] <= page.inner_text("#ramp-high")[:4] == max(days)[:4]


@pytest.mark.browser
def test_a_class_that_is_taken_out_is_not_drawn_and_the_page_remembers_it(opened: Any) -> None:
    page = opened()
    palette = tones(page)
    before = pixels_by_class(canvas(page), palette)
    assert {*page.eval_on_selector_all("#classes label", "found => found.map((one) => one.innerText.trim())")} >= {"road", "pole"}
    page.uncheck("#classes input[value=vegetation]")
    until(lambda: pixels_by_class(canvas(page), palette)["vegetation"] < 0.02 * before["vegetation"])
    assert "hide=vegetation" in page.url
    page.reload()
    until(lambda: page.evaluate(SETTLED), 60)
    assert not page.is_checked("#classes input[value=vegetation]")
    assert pixels_by_class(canvas(page), palette)["vegetation"] < 0.02 * before["vegetation"]
    page.go_back()
    until(lambda: page.is_checked("#classes input[value=vegetation]"))
    until(lambda: pixels_by_class(canvas(page), palette)["vegetation"] > 0.5 * before["vegetation"])


@pytest.mark.browser
def test_points_grow_and_an_overlay_comes_where_it_is_asked_for(opened: Any) -> None:
    page = opened()
    before, points = drawn(page), page.evaluate("wayloom3d.scene.points")
    page.evaluate("const size = document.getElementById('size'); size.value = 6; size.dispatchEvent(new Event('input'))")
    until(lambda: drawn(page) > 2 * before)
    page.check("#layers input[value=parked]")
    until(lambda: page.evaluate(SETTLED) and page.evaluate("wayloom3d.scene.points") > points + 100)
    page.uncheck("#layers input[value=parked]")
    until(lambda: page.evaluate("wayloom3d.scene.points") == points)


@pytest.mark.browser
def test_mouse_wheel_touch_and_keys_move_turn_and_zoom(opened: Any) -> None:
    page = opened()
    orbit = "(({target, distance, bearing, tilt}) => [target.x, target.y, distance, bearing, tilt])(wayloom3d.scene.orbit)"

    def moved(what: Any) -> list[bool]:
        before = page.evaluate(orbit)
        what()
        return [abs(a - b) > 1e-6 for a, b in zip(before, page.evaluate(orbit), strict=True)]

    def drag(button: str) -> None:
        page.mouse.move(600, 400)
        page.mouse.down(button=button)
        page.mouse.move(640, 440, steps=4)
        page.mouse.up(button=button)

    assert moved(lambda: drag("left")) == [True, True, False, False, False]
    assert moved(lambda: drag("right")) == [False, False, False, True, True]
    assert moved(lambda: page.mouse.wheel(0, 100))[2]
    page.focus("#view")
    assert moved(lambda: page.keyboard.press("ArrowUp"))[:2] != [False, False]
    assert moved(lambda: page.keyboard.press("Shift+ArrowLeft"))[3]
    assert moved(lambda: page.keyboard.press("+"))[2]
    page.keyboard.press("n")
    assert page.evaluate("wayloom3d.scene.orbit.bearing") == 0
    two_fingers = """(apart) => {
      const send = (kind, pointerId, clientX) => document.getElementById("view").dispatchEvent(
        new PointerEvent(kind, { pointerId, clientX, clientY: 400, pointerType: "touch", bubbles: true, buttons: 1 }));
      HTMLCanvasElement.prototype.setPointerCapture = () => {};
      send("pointerdown", 11, 500); send("pointerdown", 12, 600); send("pointermove", 12, 600 + apart);
      send("pointerup", 11, 500); send("pointerup", 12, 600 + apart);
    }"""
    before = page.evaluate("wayloom3d.scene.orbit.distance")
    page.evaluate(two_fingers, 50)
    assert page.evaluate("wayloom3d.scene.orbit.distance") == pytest.approx(before / 1.5)


@pytest.mark.browser
def test_a_click_on_a_point_tells_its_class_and_which_drives_saw_it(opened: Any, shown: LookedAt) -> None:
    page = opened("at=8.39,48.98,118&view=30,0,50&size=4&detail=5")
    spot = page.evaluate(
        """() => {
          for (let x = 400; x < 800; x += 7) for (let y = 150; y < 600; y += 7) if (wayloom3d.scene.pick(x, y, 1)) return [x, y];
        }"""
    )
    known = page.evaluate("([x, y]) => wayloom3d.scene.pick(x, y).drives", spot)
    page.mouse.click(*spot)
    page.wait_for_selector("#picked .lineage li")
    told = page.inner_text("#picked")
    assert "north street" in told
    assert f"Drives\t{known if known < 255 else '255 or more'}" in told
    assert page.get_attribute("#picked .lineage a", "href") == f"/drives/{shown.drive_id}"
    page.keyboard.press("Escape")
    until(lambda: not page.is_visible("#picked"))


@pytest.mark.browser
def test_a_flight_follows_the_drive_and_stops_at_a_hand(opened: Any, shown: LookedAt) -> None:
    page = opened(f"drive={shown.drive_id}")
    until(lambda: page.is_enabled("#play"))
    until(lambda: page.is_visible("#way"))  # what its line's colour means
    assert page.evaluate("wayloom3d.flight.length") == pytest.approx(118, abs=3)
    page.click("#play")
    until(lambda: page.evaluate("wayloom3d.flight.at") > 4)
    assert page.inner_text("#play") == "Stop"
    assert page.evaluate("Math.abs(wayloom3d.scene.orbit.bearing - 90)") < 30  # the way goes east
    page.focus("#view")
    page.keyboard.press("ArrowLeft")
    until(lambda: page.inner_text("#play") == "Fly")
    assert page.evaluate("!!wayloom3d.scene.way")
    page.select_option("#drive", "")
    until(lambda: not page.is_visible("#way"))


@pytest.mark.browser
def test_a_picture_is_saved_as_it_is_seen(opened: Any) -> None:
    page = opened()
    with page.expect_download() as found:
        page.click("#shot")
    assert found.value.suggested_filename == "wayloom-city-1.png"
    picture = cv2.imread(str(found.value.path()))
    assert picture.shape == (page.evaluate("document.getElementById('view').height"), 900, 3)
    assert (np.abs(picture.astype(int) - picture[-1, 5].astype(int)).max(axis=2) > 12).sum() > 5000


@pytest.mark.browser
def test_the_address_leads_to_the_same_view_and_the_map_to_the_same_place(opened: Any) -> None:
    page = opened("at=8.3902,48.9801,118&view=77,30,60&colour=height&size=3")
    place = "wayloom3d.scene.frame.geographic(wayloom3d.scene.orbit.target)"
    assert page.evaluate(place) == pytest.approx([8.3902, 48.9801, 118], abs=1e-6)
    assert page.evaluate("[wayloom3d.scene.orbit.distance, wayloom3d.scene.orbit.bearing, wayloom3d.scene.orbit.tilt]") == [
        77,
        30,
        60,
    ]
    assert (page.input_value("#colour"), page.input_value("#size")) == ("height", "3")
    until(lambda: page.evaluate("document.getElementById('to-map').hash").startswith("#at=8.39"))
    lon, lat, zoom = (float(one) for one in unquote(page.evaluate("document.getElementById('to-map').hash"))[4:].split(","))
    assert (lon, lat) == pytest.approx((8.3902, 48.9801), abs=1e-6)
    assert 18 < zoom < 21


@pytest.mark.browser
def test_a_version_that_is_published_meanwhile_is_shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    served = looked_at(tmp_path_factory.mktemp("renewed") / "data", voxels=1500)
    with closing(served.api):
        watched = Page(browser, f"{served.api.url}/3d")
        page = watched.settled()
        page.evaluate("wayloom3d.scene.detailPx = 0.01; wayloom3d.scene.redraw()")
        until(lambda: page.evaluate("wayloom3d.scene.points") == len(served.city))
        served.publish(made_map(2500, extent_m=60.0))
        until(lambda: page.inner_text("#version") == "city · version 2")
        until(lambda: page.evaluate("wayloom3d.scene.points") == len(served.city))
        watched.close()


@pytest.mark.browser
def test_without_webgl_the_page_says_what_to_do(browser: Any, shown: LookedAt) -> None:
    page = browser.new_page()
    page.add_init_script(NO_WEBGL)
    page.goto(f"{shown.api.url}/3d")
    page.wait_for_selector("#message:not([hidden])")
    assert "hardware acceleration" in page.inner_text("#message")
    assert "wayloom export" in page.inner_text("#message")
    page.close()


@pytest.mark.browser
def test_a_service_without_a_map_says_so_and_shows_the_first_one(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("empty") / "data"
    with closing(ApiAlone(folder)) as alone:
        page = browser.new_page()
        page.goto(f"{alone.url}/3d")
        page.wait_for_selector("#message:not([hidden])")
        assert "Nothing to show yet" in page.inner_text("#message")
        LookedAt(alone, made_map(10), "").publish(made_map(1500, extent_m=60.0))
        until(lambda: page.evaluate(SETTLED), 60)
        assert not page.is_visible("#message")
        page.close()
