"""The map's legend in a browser: it lists classes that are there, switches them, and says what colours mean."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from map_pages import Open, like, opening, tone

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until
from tiles.made_maps import made_map
from wayloom.config.classes import CLASS_NAMES

AT = "at=8.39,48.98,19"
LISTED = "found => found.map((one) => one.innerText.trim())"


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LookedAt]:
    served = looked_at(tmp_path_factory.mktemp("legend") / "data")
    with closing(served.api):
        yield served


@pytest.mark.browser
def test_a_class_is_listed_where_it_is_and_its_pixels_go_and_come_with_its_box(opened: Open, shown: LookedAt) -> None:
    page = opened(AT)
    there = {CLASS_NAMES[label] for label in np.unique(shown.city.label)}
    until(lambda: {*page.eval_on_selector_all("#legend li", LISTED)} == there)
    sidewalk = tone(page, "sidewalk")
    before = like(page, sidewalk)
    assert before > 200
    page.uncheck("#legend input[value=sidewalk]")
    until(lambda: like(page, sidewalk) < 0.05 * before, 60)
    assert "hide=sidewalk" in page.url
    page.go_back()
    until(lambda: like(page, sidewalk) > 0.9 * before, 60)
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


@pytest.mark.browser
def test_the_legend_names_classes_of_overlays_that_are_shown_and_in_sight(browser: Any, tmp_path: Path) -> None:
    city = made_map(6000, extent_m=60.0)
    cars = city.take(np.arange(0, len(city), 7))
    parked = replace(cars, label=np.full_like(cars.label, CLASS_NAMES.index("car")))
    served = looked_at(tmp_path / "data", parked=parked)
    with closing(served.api), opening(browser, served) as opened:
        page = opened(AT)
        assert page.locator("#legend [data-of=parked]").count() == 0
        page.check("#show-parked")
        until(lambda: page.locator("#legend [data-of=parked]").count() == 1, 60)
        assert page.inner_text("#legend [data-of=parked]").split("\n") == ["Parked", "car"]
        page.uncheck("#show-parked")
        until(lambda: page.locator("#legend [data-of=parked]").count() == 0, 60)
        page.check("#show-parked")
        until(lambda: page.locator("#legend [data-of=parked]").count() == 1, 60)
        page.evaluate("wayloomMap.jumpTo({center: [8.45, 48.98]})")
        until(lambda: page.locator("#legend [data-of=parked]").count() == 0, 60)


@pytest.mark.browser
def test_the_legend_names_the_colours_of_drives_and_of_the_one_that_is_chosen(opened: Open, shown: LookedAt) -> None:
    page = opened(AT)
    meaning = page.locator("#legend .by >> nth=0").locator(".key")
    until(lambda: meaning.all_inner_texts() == ["drives"])
    page.click(f"[data-id='{shown.drive_id}'] .show")
    until(lambda: meaning.all_inner_texts() == ["drives", "chosen drive"])


@pytest.mark.browser
def test_the_legend_names_things_that_are_new_and_that_have_gone(browser: Any, tmp_path: Path) -> None:
    served = looked_at(tmp_path / "data", changes=True)
    with closing(served.api), opening(browser, served) as opened:
        page = opened(AT)
        until(lambda: page.locator("#legend [data-of=changes] .key").all_inner_texts() == ["is new", "has gone"], 60)
