"""Places on the map in a browser: what a click and the keyboard tell of them, sites that lie apart, and what has changed."""

from collections.abc import Iterator
from contextlib import closing

import pytest
from map_pages import Open

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until
from wayloom.geodesy import wgs84


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    served = looked_at(tmp_path_factory.mktemp("places") / "data", away_m=3600.0, changes=True)
    with closing(served.api):
        yield served


def place_of_a_voxel(shown: LookedAt) -> tuple[float, float]:
    assert shown.city.frame is not None
    lon, lat, _ = wgs84.lonlatheight_from_enu(shown.city.points_enu[:1], shown.city.frame)[0].tolist()
    return lon, lat


@pytest.mark.browser
def test_a_click_tells_voxels_and_drives_and_the_keyboard_reaches_them_too(opened: Open, shown: LookedAt) -> None:
    lon, lat = place_of_a_voxel(shown)
    page = opened(f"at={lon:.7f},{lat:.7f},20&off=tracks,objects")
    box = page.locator("#map").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector("#told .lineage li")
    told = page.inner_text("#told")
    assert "north street" in told
    assert "within 1 m" in told
    assert page.get_attribute("#told .lineage a", "href") == f"/drives/{shown.drive_id}"
    until(lambda: f"told={lon:.7f}"[:-4] in page.url)
    assert page.get_attribute("#told p a", "href").startswith("/3d#at=")
    page.click("#told h2 button")
    until(lambda: not page.is_visible("#told") and "told=" not in page.url)
    page.focus(".maplibregl-canvas")
    page.keyboard.press("Enter")
    page.wait_for_selector("#told .lineage li")
    assert page.evaluate("document.activeElement.id") == "told"
    page.keyboard.press("Escape")
    until(lambda: not page.is_visible("#told"))
    assert page.evaluate("document.activeElement.className") == "maplibregl-canvas"


@pytest.mark.browser
def test_a_tile_is_told_of_from_afar_and_the_address_brings_it_back(opened: Open, shown: LookedAt) -> None:
    lon, lat = place_of_a_voxel(shown)
    page = opened(f"at={lon:.7f},{lat:.7f},15.5&off=tracks&told={lon:.7f},{lat:.7f}")
    page.wait_for_selector("#told .lineage li")
    assert "tile\t15/" in page.inner_text("#told")
    assert page.evaluate("wayloomMap.queryRenderedFeatures({layers: ['told-tile']}).length") > 0


@pytest.mark.browser
def test_sites_that_lie_apart_are_marks_from_afar_and_a_list_leads_to_each(opened: Open) -> None:
    page = opened("at=8.41,48.98,9")
    until(lambda: page.locator("button.site").count() == 1)  # over each other: one mark for both
    assert page.get_attribute("button.site", "aria-label") == "2 sites, 1 drive: go there"
    page.click("button.site")
    until(lambda: page.locator("button.site").count() == 2)
    page.click("#list-sites")
    assert page.locator("#map-list li").count() == 2
    page.click("#map-list li button >> nth=1")
    until(lambda: page.evaluate("wayloomMap.getZoom()") > 16 and page.locator("button.site").count() == 0)
    assert page.evaluate("wayloomMap.getCenter().lng") > 8.43
    page.keyboard.press("Escape")
    until(lambda: not page.is_visible("#map-list"))


@pytest.mark.browser
def test_sites_that_lie_apart_have_insets_that_are_reached_by_keys_and_say_where_one_is(opened: Open) -> None:
    page = opened("at=8.41,48.98,9")
    until(lambda: page.locator("#insets .inset").count() == 2)
    names = page.eval_on_selector_all(".inset", "found => found.map((one) => one.ariaLabel)")
    assert all(name.startswith(f"Site {number}: 48.98") and name.endswith("go there") for number, name in enumerate(names, 1))
    assert page.eval_on_selector_all(".inset svg path.area", "found => found.every((one) => one.getAttribute('d').length > 10)")
    for number in range(2):
        page.focus(f".inset >> nth={number}")
        page.keyboard.press("Enter")
        until(
            lambda number=number: (
                page.locator(".inset[aria-current=location]").count() == 1
                and page.get_attribute(f".inset >> nth={number}", "aria-current") == "location"
            )
        )
        assert page.evaluate("wayloomMap.getZoom()") > 14


@pytest.mark.browser
def test_changes_are_on_the_map_and_in_a_list_that_leads_to_them(opened: Open) -> None:
    page = opened("at=8.39,48.98,19&off=tracks")
    until(lambda: page.evaluate("wayloomMap.queryRenderedFeatures({layers: ['changes']}).length") == 2, 60)
    page.click("#list-changes")
    rows = page.eval_on_selector_all("#map-list li", "found => found.map((one) => one.innerText.replace(/\\s+/g, ' ').trim())")
    assert rows == ["pole is new noticed 2026-06-02", "traffic sign has gone noticed 2026-06-01"]
    page.click("#map-list li button >> nth=1")
    until(lambda: page.is_visible("#told") and "traffic sign has gone" in page.inner_text("#told"), 60)
