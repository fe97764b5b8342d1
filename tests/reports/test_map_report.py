"""A map's report is one page that needs nothing else, and lists what is there."""

import json
import os
import re
from pathlib import Path

import pytest

from exports.made_sources import drives_with_ground, made_source
from wayloom.cli.main import app
from wayloom.errors import InputError, UnknownFormatError
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.reports.map_report import map_facts, write_map_report
from wayloom.stitching.settings import MergeSettings

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return drives_with_ground(tmp_path_factory.mktemp("drives"))


@pytest.fixture(scope="module")
def page_file(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "map.html"
    assert write_map_report(DriveOutputs(folders, MergeSettings()), out, "a & b").startswith("2 drives, ")
    return out


def test_the_page_stands_by_itself_and_lists_what_is_there(page_file: Path) -> None:
    page = page_file.read_text(encoding="utf-8")
    assert re.findall(r"(?:src|href)=\"(?!data:)", page) == []
    assert "<h1>a &amp; b</h1>" in page
    assert page.count("data:image/jpeg") == 4
    assert "pole" in page
    assert "bicycle" not in page


def test_the_facts_are_those_of_the_map() -> None:
    source = made_source(400, extent_m=40.0)
    labels = source.whole.label
    facts = map_facts(source, labels)
    assert facts["points"] == len(labels)
    assert sum(one["points"] for one in facts["classes"]) == (labels < 19).sum()
    assert [one["points"] for one in facts["classes"]] == sorted((one["points"] for one in facts["classes"]), reverse=True)
    assert facts["road_m"] == pytest.approx(sum(drive["road_m"] for drive in facts["drives"]))


def test_a_box_without_anything_leaves_no_page(folders: list[Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing"):
        write_map_report(DriveOutputs(folders, MergeSettings()), tmp_path / "map.html", "none", (0.0, 0.0, 1.0, 1.0))
    assert [*tmp_path.iterdir()] == []


def test_the_command_writes_a_page_and_no_other_file(folders: list[Path], tmp_path: Path) -> None:
    app(["report", *map(str, folders), "--out", str(tmp_path / "map.html")], standalone_mode=False)
    assert [path.name for path in tmp_path.iterdir()] == ["map.html"]
    with pytest.raises(UnknownFormatError, match="no page"):
        app(["report", *map(str, folders), "--out", str(tmp_path / "map.pdf")], standalone_mode=False)


@pytest.mark.browser
@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_shows_all_of_it_without_network(page_file: Path, width: int) -> None:
    if not CHROMIUM.exists():
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"no {CHROMIUM}: install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_context(offline=True, viewport={"width": width, "height": 900}).new_page()
        complaints: list[str] = []
        page.on("console", lambda message: complaints.append(message.text))
        page.goto(page_file.as_uri())
        assert complaints == []
        assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        if folder := os.environ.get("WAYLOOM_SHOTS"):
            page.screenshot(path=f"{folder}/map-report-{width}.png", full_page=True)
        browser.close()


def test_what_drives_warn_of_stands_before_the_map(tmp_path: Path) -> None:
    sure, doubtful = drives_with_ground(tmp_path)
    (sure / "report.json").write_text(json.dumps({"warnings": []}))
    (doubtful / "report.json").write_text(json.dumps({"warnings": ["GNSS and odometry disagree by 3 %", "labels <mostly> wrong"]}))
    write_map_report(DriveOutputs([sure, doubtful], MergeSettings()), tmp_path / "map.html", "two")
    page = (tmp_path / "map.html").read_text(encoding="utf-8")
    told = page[page.index("Before you trust this map") : page.index("<h2>The map</h2>")]
    assert "b" * 64 in told
    assert "a" * 64 not in told
    assert "disagree by 3 %" in told
    assert "&lt;mostly&gt;" in told
