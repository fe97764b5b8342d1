"""Excluded areas on the map in a browser: hatched where there are some, told by the legend, switched off and on."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx2
import pytest
from map_pages import Open, like

from service_kit.looked_at import LookedAt, looked_at
from service_kit.running import until

AT = "at=8.39,48.98,19&off=semantic,tracks"
YARD = [[8.3898, 48.9799], [8.3902, 48.9799], [8.3902, 48.9801], [8.3898, 48.9801], [8.3898, 48.9799]]
QUIET = (91, 104, 112)
QUIET_IN_THE_DARK = (147, 161, 170)
DRAWN = "wayloomMap.queryRenderedFeatures({layers: ['excluded']}).map((one) => one.properties.name)"


@pytest.fixture
def shown(tmp_path: Path) -> Iterator[LookedAt]:
    served = looked_at(tmp_path / "data", voxels=1000)
    with closing(served.api):
        yield served


@pytest.mark.browser
def test_an_area_appears_with_the_version_that_lacks_it_and_is_switched(opened: Open, shown: LookedAt) -> None:
    page = opened(AT)
    assert not page.is_visible("#show-excluded")
    bare = like(page, QUIET)  # words of the tools
    feature = {"type": "Feature", "properties": {"name": "yard"}, "geometry": {"type": "Polygon", "coordinates": [YARD]}}
    answer = httpx2.post(f"{shown.api.url}/v1/excluded-areas", json=feature, timeout=30.0, trust_env=False)
    assert answer.status_code == 201
    shown.publish(shown.city)
    until(lambda: page.is_visible("#show-excluded"), 60)
    until(lambda: page.evaluate(DRAWN) == ["yard"], 60)
    until(lambda: like(page, QUIET) > bare + 1000, 60)
    until(lambda: page.locator("#legend [data-of=privacy] .key").all_inner_texts() == ["excluded area"], 60)
    page.uncheck("#show-excluded")
    until(lambda: "off=semantic,tracks,excluded" in page.url and like(page, QUIET) < bare + 200, 60)
    until(lambda: page.locator("#legend [data-of=privacy]").count() == 0, 60)
    page.go_back()
    until(lambda: page.is_checked("#show-excluded") and like(page, QUIET) > bare + 1000, 60)

    page.click("#compare")
    page.wait_for_function("globalThis.wayloomOther?.getLayer('excluded')")
    until(lambda: page.evaluate(DRAWN.replace("wayloomMap", "wayloomOther")) == ["yard"], 60)
    page.emulate_media(color_scheme="dark")
    until(lambda: like(page, QUIET_IN_THE_DARK) > 1000, 60)
