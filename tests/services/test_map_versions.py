"""Versions on the map in a browser: one by the slider, two beside each other, and the view in the page's address."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from map_pages import READY, Open, like, opening, tone

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until
from wayloom.config.classes import CLASS_NAMES

AT = "at=8.39,48.98,19&off=tracks"
CLASSES = ("road", "vegetation", "sidewalk")


@pytest.fixture
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    """The second version is all road, the third all vegetation."""
    served = looked_at(tmp_path_factory.mktemp("versions") / "data", voxels=4000)
    for name in CLASSES[:2]:
        served.publish(painted(served, name))
    with closing(served.api):
        yield served


def painted(served: LookedAt, name: str) -> Any:
    label = np.full(len(served.city), CLASS_NAMES.index(name), np.uint8)
    return replace(served.city, label=label)


@pytest.mark.browser
def test_slider_swipe_publication_and_address_show_the_versions_that_they_name(opened: Open, shown: LookedAt) -> None:
    page = opened(AT)
    tones = {name: tone(page, name) for name in CLASSES}
    until(lambda: like(page, tones["vegetation"]) > 500, 60)
    words = "document.getElementById('version-words').textContent"
    until(lambda: page.evaluate(words).startswith("version 3, newest"))
    page.focus("#version-slider")
    page.keyboard.press("ArrowLeft")
    until(lambda: like(page, tones["road"]) > 500 and like(page, tones["vegetation"]) == 0, 60)
    assert "v=2" in page.url
    page.keyboard.press("ArrowRight")
    until(lambda: like(page, tones["vegetation"]) > 500, 60)
    assert "v=" not in page.url

    page.click("#compare")
    until(lambda: like(page, tones["road"]) > 200 and like(page, tones["vegetation"]) > 200, 90)
    assert page.input_value("#compare-with") == "2"
    both = like(page, tones["vegetation"])
    page.focus("#swipe-line")
    assert page.get_attribute("#swipe-line", "aria-valuenow") == "50"
    page.keyboard.press("PageUp")
    page.keyboard.press("ArrowRight")
    assert page.get_attribute("#swipe-line", "aria-valuenow") == "62"
    until(lambda: like(page, tones["vegetation"]) > 1.1 * both)
    page.evaluate("wayloomMap.jumpTo({zoom: 18.5})")
    until(lambda: page.evaluate("Math.abs(wayloomOther.getZoom() - 18.5)") < 1e-6)
    until(lambda: "swipe=2,0.62" in page.url)
    page.reload()
    until(lambda: page.evaluate(READY), 90)
    until(lambda: like(page, tones["road"]) > 100 and like(page, tones["vegetation"]) > 100, 90)
    assert page.get_attribute("#swipe-line", "aria-valuenow") == "62"
    assert page.evaluate("wayloomMap.getZoom()") == pytest.approx(18.5)
    page.click("#compare")
    until(lambda: like(page, tones["road"]) == 0)

    shown.publish(painted(shown, "sidewalk"))
    until(lambda: like(page, tones["sidewalk"]) > 200, 60)
    until(lambda: page.evaluate(words).startswith("version 4, newest"))


@pytest.mark.browser
def test_each_side_of_the_line_shows_the_coverage_of_its_own_version(browser: Any, tmp_path: Path) -> None:
    served = looked_at(tmp_path / "data", voxels=2000)  # of two drives; the second version is of one
    replace(served, held=served.held[:1]).publish(served.city)
    counts = "queryRenderedFeatures({layers: ['coverage']}).map((one) => one.properties.drives)"
    fill = "getPaintProperty('coverage', 'fill-color')"
    with closing(served.api), opening(browser, served) as open_:
        page = open_(f"{AT},semantic")
        page.select_option("#coverage-by", "drives")
        until(lambda: {*page.evaluate(f"wayloomMap.{counts}")} == {1}, 60)
        page.click("#compare")
        page.wait_for_function("globalThis.wayloomOther?.getLayer('coverage')")
        until(lambda: {*page.evaluate(f"wayloomOther.{counts}")} == {1, 2}, 60)
        assert page.inner_text("#legend .by >> nth=1").split("\n")[-2:] == ["1 drive", "2 drives"]
        assert page.evaluate(f"wayloomMap.{fill}") == page.evaluate(f"wayloomOther.{fill}")
        page.uncheck("#show-coverage")
        until(lambda: page.evaluate("wayloomOther.getLayoutProperty('coverage', 'visibility')") == "none")
        page.check("#show-coverage")
        page.click("#compare")
        page.focus("#version-slider")
        page.keyboard.press("ArrowLeft")
        until(lambda: {*page.evaluate(f"wayloomMap.{counts}")} == {1, 2}, 60)
