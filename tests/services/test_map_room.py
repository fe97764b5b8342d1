"""What the map shows first lies beside the panels that cover it, on a desk and on a phone."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from map_pages import READY

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until

PANELS = "#tools, #legend, #versions, #insets, .maplibregl-ctrl-group, .maplibregl-ctrl-scale"
BOXES = f"""() => {{
  const map = document.getElementById("map").getBoundingClientRect();
  return [...document.querySelectorAll("{PANELS}")].map((one) => one.getBoundingClientRect()).filter((box) => box.width)
    .map((box) => [box.left - map.left, box.top - map.top, box.right - map.left, box.bottom - map.top]);
}}"""
SHOWN = """() => {
  const [west, south, east, north] = wayloomTools.legend.city.coverage.box;
  const [low, high] = [wayloomMap.project([west, south]), wayloomMap.project([east, north])];
  return [low.x, high.y, high.x, low.y];
}"""
STILL = f"{READY} && wayloomMap.areTilesLoaded()"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    served = looked_at(tmp_path_factory.mktemp("room") / "data", away_m=3600.0, changes=True)
    with closing(served.api):
        yield served


def opened(browser: Any, shown: LookedAt, width: int, height: int) -> Any:
    page = browser.new_page(viewport={"width": width, "height": height}, reduced_motion="reduce")
    page.goto(shown.api.url)
    until(lambda: page.evaluate(STILL), 90)
    return page


def covered(page: Any) -> list[list[float]]:
    """The panels that lie over what is mapped."""
    left, top, right, bottom = page.evaluate(SHOWN)
    return [box for box in page.evaluate(BOXES) if box[0] < right and box[2] > left and box[1] < bottom and box[3] > top]


@pytest.mark.browser
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (1100, 700), (390, 844)])
def test_the_first_view_and_fit_map_lie_beside_all_panels(browser: Any, shown: LookedAt, width: int, height: int) -> None:
    page = opened(browser, shown, width, height)
    until(lambda: covered(page) == [])
    left, _, right, _ = page.evaluate(SHOWN)
    assert right - left > 0.4 * page.locator("#map").bounding_box()["width"]
    page.evaluate("wayloomMap.jumpTo({ center: [8.3, 48.9], zoom: 12 })")
    page.click("#fit")
    until(lambda: covered(page) == [])
    page.close()


@pytest.mark.browser
def test_who_has_moved_the_map_is_not_taken_back(browser: Any, shown: LookedAt) -> None:
    page = opened(browser, shown, 1300, 800)
    page.click(".maplibregl-ctrl-zoom-in")
    until(lambda: page.evaluate("!wayloomMap.isMoving()"))
    view = page.evaluate("wayloomMap.getCenter().toArray().concat(wayloomMap.getZoom())")
    page.evaluate("wayloomTools.legend.city.refit()")
    assert page.evaluate("wayloomMap.getCenter().toArray().concat(wayloomMap.getZoom())") == view
    page.close()


@pytest.mark.browser
def test_on_a_phone_the_legend_is_closed_says_so_and_opens_over_half_of_the_map_at_most(browser: Any, shown: LookedAt) -> None:
    page = opened(browser, shown, 390, 844)
    told = page.context.new_cdp_session(page)
    assert is_expanded(told) is False
    assert not page.is_visible("#legend ul")
    page.click("#legend summary")  # nothing lies over it
    assert is_expanded(told) is True
    map_height = page.locator("#map").bounding_box()["height"]
    assert page.is_visible("#legend ul")
    assert page.locator("#legend").bounding_box()["height"] <= 0.5 * map_height
    page.focus("#legend summary")
    page.keyboard.press("Enter")
    assert is_expanded(told) is False
    page.close()


def is_expanded(told: Any) -> bool | None:
    """What a screen reader hears of the legend's state."""
    nodes = told.send("Accessibility.getFullAXTree")["nodes"]
    (legend,) = [one for one in nodes if one.get("name", {}).get("value") == "Legend" and "Disclosure" in one["role"]["value"]]
    found = [one["value"]["value"] for one in legend["properties"] if one["name"] == "expanded"]
    return found[0] if found else None
