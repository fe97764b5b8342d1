"""The report opened as a customer would: in a browser, from a file, with no network and no scripts."""

import os
from pathlib import Path

import pytest

from reports.made_result import made_result
from wayloom.pipeline.exports import write_exports
from wayloom.reports.drive_report import write_report

pytestmark = pytest.mark.browser
CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    result = made_result(tmp_path_factory.mktemp("drive"))
    out = tmp_path_factory.mktemp("out")
    write_exports(result.log, result.odometry, result.images, result.geo, result.submaps, out)
    write_report(result, out)
    return out / "report.html"


@pytest.fixture(scope="module")
def browser():
    if not CHROMIUM.exists():
        message = f"no {CHROMIUM}: install chromium"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox", "--disable-gpu"])
        yield launched
        launched.close()


@pytest.mark.parametrize("width", [1280, 390])
def test_the_report_shows_everything_without_network_or_scripts(browser, page_file, width):
    context = browser.new_context(offline=True, java_script_enabled=True, viewport={"width": width, "height": 900})
    page = context.new_page()
    asked, complaints = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(page_file.as_uri())
    assert [url for url in asked if not url.startswith(("data:", "file:"))] == []
    assert complaints == []
    assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")
    assert page.locator("svg").count() == 4
    assert page.locator("svg").first.bounding_box()["height"] > 100
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    context.close()


def test_the_report_is_dark_where_the_reader_wants_it_dark(browser, page_file):
    shades = {}
    for scheme in ("light", "dark"):
        context = browser.new_context(offline=True, color_scheme=scheme, viewport={"width": 390, "height": 900})
        page = context.new_page()
        page.goto(page_file.as_uri())
        colour = "e => getComputedStyle(document.body)[e].match(/\\d+/g).slice(0, 3).map(Number).reduce((a, b) => a + b) / 3"
        shades[scheme] = [page.evaluate(colour, name) for name in ("backgroundColor", "color")]
        context.close()
    assert shades["light"][0] > 200 > 100 > shades["light"][1]
    assert shades["dark"][0] < 60 < 180 < shades["dark"][1]
