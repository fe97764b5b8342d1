"""The map's legend in a browser: it lists classes that are there, switches them, and says what colours mean."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from map_pages import Open, like, opening

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until
from wayloom.config.classes import CLASS_NAMES, PALETTE

AT = "at=8.39,48.98,19"
SIDEWALK = tuple(PALETTE[CLASS_NAMES.index("sidewalk")].tolist())
LISTED = "found => found.map((one) => one.innerText.trim())"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    served = looked_at(tmp_path_factory.mktemp("legend") / "data")
    with closing(served.api):
        yield served


@pytest.fixture
def opened(browser: Any, shown: LookedAt) -> Iterator[Open]:
    with opening(browser, shown) as open_:
        yield open_


@pytest.mark.browser
def test_a_class_is_listed_where_it_is_and_its_pixels_go_and_come_with_its_box(opened: Open, shown: LookedAt) -> None:
    page = opened(AT)
    there = {CLASS_NAMES[label] for label in np.unique(shown.city.label)}
    until(lambda: {*page.eval_on_selector_all("#legend li", LISTED)} == there)
    before = like(page, SIDEWALK)
    assert before > 200
    page.uncheck("#legend input[value=sidewalk]")
    until(lambda: like(page, SIDEWALK) < 0.05 * before, 60)
    assert "hide=sidewalk" in page.url
    page.go_back()
    until(lambda: like(page, SIDEWALK) > 0.9 * before, 60)
    assert page.is_checked("#legend input[value=sidewalk]")


@pytest.mark.browser
def test_tracks_are_coloured_by_vehicle_grade_or_age_with_their_legend(opened: Open) -> None:
    page = opened(f"{AT}&off=semantic")
    until(lambda: like(page, (31, 111, 139)) > 300)
    page.select_option("#tracks-by", "vehicle")
    until(lambda: like(page, (0, 114, 178)) > 300)
    assert page.inner_text("#legend .meaning >> nth=0").strip() == "bus 1"
    page.select_option("#tracks-by", "grade")
    until(lambda: like(page, (138, 148, 155)) > 300)
    assert page.inner_text("#legend .meaning >> nth=0").strip() == "none"
    page.select_option("#tracks-by", "age")
    until(lambda: page.locator("#legend .ramp").count() == 1)
    assert "tracks=age" in page.url


@pytest.mark.browser
def test_coverage_is_coloured_by_drives_and_by_the_last_one(opened: Open) -> None:
    page = opened(f"{AT}&off=semantic,tracks")
    page.select_option("#coverage-by", "drives")
    until(lambda: page.is_checked("#show-coverage"))
    drawn = "wayloomMap.queryRenderedFeatures({layers: ['coverage']}).map((one) => one.properties.drives)"
    until(lambda: {*page.evaluate(drawn)} == {1, 2}, 60)
    assert page.inner_text("#legend .by >> nth=1").split("\n")[-2:] == ["1 drive", "2 drives"]
    assert like(page, (253, 231, 37), 110) > 200  # the end of the ramp, over the grid
    page.select_option("#coverage-by", "age")
    until(lambda: page.inner_text("#legend .by >> nth=1").endswith("2026-06-02"))
    assert "coverage=age" in page.url
