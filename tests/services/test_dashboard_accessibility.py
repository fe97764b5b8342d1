"""Every page in real Chromium under axe-core, light and dark, narrow and wide: no violation; and colours that can be told apart."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from service_kit import little_stages
from service_kit.browsers import chromium, shot, tones
from service_kit.colours import apart, contrast
from service_kit.filled_service import filled
from service_kit.javascript import packages
from service_kit.running import until
from wayloom.config.classes import CLASS_NAMES, PALETTE

PAGES = {
    "map": "/", "drive": "/drives/{done}", "held drive": "/drives/{held}", "failed drive": "/drives/{failed}", "fleet": "/fleet",
    "areas": "/areas", "access": "/access", "sign-in": "/sign-in", "3d": "/3d",
    "no drive": "/drives/nonsense", "no page": "/nonsense",
}  # fmt: skip
READY = {
    "map": "#drives .drive", "drive": "[data-plot=sigma] svg", "held drive": "#history table", "failed drive": "#history table",
    "fleet": "#vehicles table", "areas": "#areas table", "access": "#keys table", "sign-in": "#sign-in",
    "3d": "#panel", "no drive": "#none:not([hidden])", "no page": ".missing",
}  # fmt: skip
RUN = """() => axe.run(document, { resultTypes: ["violations"] }).then(({ violations }) => violations.map((one) =>
  [one.id, ...one.nodes.slice(0, 5).map(({ target, any }) => `${target} ${any.map((check) => check.message)}`)].join(" | ")))"""

GROUND = "getComputedStyle(document.getElementById('map')).backgroundColor"
SWATCH = """(name) => {
  const item = [...document.querySelectorAll("#legend li")].find((one) => one.textContent.trim() === name);
  const pen = new OffscreenCanvas(1, 1).getContext("2d");
  pen.fillStyle = getComputedStyle(item.querySelector("i")).backgroundColor;
  pen.fillRect(0, 0, 1, 1);
  return [...pen.getImageData(0, 0, 1, 1).data].slice(0, 3);
}"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, str, dict[str, str]]]:
    """A browser, a service's address, and its drives by their states."""
    alone, ids = filled(tmp_path_factory.mktemp("api") / "data")
    with chromium() as browser:
        yield browser, alone.url, ids
    alone.close()


@pytest.fixture(scope="module")
def axe() -> str:
    return (packages() / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1600])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_has_a_violation(shown: tuple[Any, str, dict[str, str]], axe: str, scheme: str, width: int) -> None:
    browser, url, ids = shown
    context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": 900})
    page = context.new_page()
    found = {}
    for name, path in PAGES.items():
        page.goto(url + path.format(**ids))
        page.wait_for_selector(READY[name])
        if name == "map":
            until(lambda: page.evaluate("!!globalThis.wayloomMap?.getLayer('semantic')"))
        page.evaluate(axe)
        if violations := page.evaluate(RUN):
            found[name] = violations
        assert page.evaluate("document.documentElement.scrollWidth") <= width, f"{name} is wider than its window"
    assert found == {}, "\n".join(f"{name}: {one}" for name, all_of in found.items() for one in all_of)
    context.close()


@pytest.mark.browser
def test_dialogs_have_no_violation_either_and_give_the_focus_back(shown: tuple[Any, str, dict[str, str]], axe: str) -> None:
    browser, url, ids = shown
    page = browser.new_page()
    page.goto(f"{url}/drives/{ids['quarantined']}")
    page.focus("#delete")
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open]")
    assert page.evaluate("document.activeElement.closest('dialog') !== null")
    page.evaluate(axe)
    assert page.evaluate(RUN) == []
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog", state="detached")
    until(lambda: page.evaluate("document.activeElement.id") == "delete")
    page.close()


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_swatch_of_the_legend_has_an_edge_that_stands_out_and_its_name_beside_it(
    shown: tuple[Any, str, dict[str, str]], scheme: str
) -> None:
    """Colours of classes are fixed, some near black and some near white: the edge carries the shape, the name the meaning."""
    browser, url, _ = shown
    page = browser.new_page(color_scheme=scheme)
    page.goto(url)
    page.wait_for_selector("#legend li")
    swatches = page.evaluate(
        """[...document.querySelectorAll("#legend li")].map((item) => [
             item.textContent, getComputedStyle(item.querySelector("i")).borderTopColor,
             getComputedStyle(document.getElementById("legend")).backgroundColor,
           ])"""
    )
    assert len(swatches) >= 8
    for name, edge, ground in swatches:
        assert name in CLASS_NAMES
        assert contrast(edge, ground) >= 3.0, f"{name}: {edge} on {ground}"
    page.close()


@pytest.mark.browser
def test_every_class_stands_off_the_map_in_light_and_dark_and_none_looks_like_another(
    shown: tuple[Any, str, dict[str, str]],
) -> None:
    browser, url, _ = shown
    page = browser.new_page()
    page.goto(url)
    page.wait_for_selector("#legend li")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        ground = page.evaluate(GROUND)
        palette = tones(page)
        seen = {name: contrast(f"rgb{tuple(colour)}", ground) for name, colour in zip(CLASS_NAMES, palette.tolist(), strict=True)}
        assert min(seen.values()) >= 3.0, f"{scheme}: {min(seen, key=seen.__getitem__)} has {min(seen.values()):.2f}"
        assert apart(palette).min() > 0.035, f"{scheme}: two classes are as good as one"
        np.testing.assert_array_equal(palette, tones(page, scheme))
    light, dark = tones(page, "light"), tones(page, "dark")
    assert not np.array_equal(light, dark)
    stays = [name for name, same in zip(CLASS_NAMES, (dark == PALETTE).all(axis=1), strict=True) if same]
    assert {"sidewalk", "traffic sign", "terrain", "rider"} <= {*stays}
    page.close()


@pytest.mark.browser
def test_pictures_have_the_legends_tones_and_follow_the_scheme(shown: tuple[Any, str, dict[str, str]]) -> None:
    browser, url, _ = shown
    page = browser.new_page(color_scheme="dark", viewport={"width": 1300, "height": 800})
    page.goto(f"{url}/#at={little_stages.LON + 0.0005},{little_stages.LAT + 0.0005},17&off=tracks")
    page.wait_for_selector("#legend li")
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        road = tones(page)[0]
        assert page.evaluate(SWATCH, "road") == road.tolist()
        until(lambda road=road: int((np.abs(shot(page).astype(int) - road).max(axis=2) <= 1).sum()) > 5000, 60)
    page.close()


def test_the_contrast_of_black_and_white_is_21_and_of_equal_colours_1() -> None:
    assert contrast("rgb(0, 0, 0)", "rgb(255, 255, 255)") == pytest.approx(21.0)
    assert contrast("rgb(90, 90, 90)", "rgb(90, 90, 90)") == 1.0
