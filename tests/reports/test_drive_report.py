"""The report of a drive says the same in JSON and HTML, needs nothing from outside, and trusts no name."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from reports.made_result import POINTS, made_result, renamed
from wayloom.config.stages import drive_stages
from wayloom.pipeline.exports import write_exports
from wayloom.reports.drive_report import number, thousands, write_report
from wayloom.reports.facts import class_counts, drive_facts, finite, row_offset_in_corner
from wayloom.reports.triple import cloud_views


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return made_result(tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    return written(result, tmp_path_factory.mktemp("out"))


def written(result, folder):
    write_exports(result.log, result.odometry, result.images, result.geo, result.submaps, folder)
    write_report(result, folder)
    return folder


def test_the_json_says_what_was_measured(folder, result):
    facts = json.loads((folder / "report.json").read_text())
    assert facts["format"] == "wayloom-drive-report"
    assert facts["odometry"]["frames"] == facts["odometry"]["frames_tracked"] == 30
    assert facts["odometry"]["distance_m"] == pytest.approx(58 * 1.01, rel=1e-3)
    assert facts["odometry"]["disparity_bias_px"] == -0.4
    assert facts["log"]["gnss"]["share"]["fixed"] == pytest.approx(2 / 3)
    assert facts["georeference"]["origin"] == {"lon_deg": 8.5, "lat_deg": 49.5, "height_m": 0.0}
    assert facts["truth"]["length_ratio"] == pytest.approx(1.01, rel=1e-3)
    assert facts["cloud"]["points"] == sum(len(placed.submap) for placed in result.submaps)
    assert tuple(facts["stages"]) == drive_stages()
    assert facts["stages"]["ingest"] == {"seconds": 0.1, "reused": True}


def test_every_point_is_counted_once_in_each_column(result):
    counts = class_counts(result)
    for column in ("baseline", "tcl_mono", "tcl_stereo"):
        assert sum(row[column] for row in counts.values()) == POINTS
    assert counts["sidewalk"]["baseline"] > 0
    assert counts["sidewalk"]["tcl_stereo"] == 0


class Outside(HTMLParser):
    """Collects every address that a page would load, and its open and closed tags."""

    def __init__(self):
        super().__init__()
        self.addresses, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action", "data") and value]


def test_the_page_loads_nothing_and_runs_nothing(folder):
    page = Outside()
    text = (folder / "report.html").read_text()
    page.feed(text)
    assert all(address.startswith(("data:image/", "#")) for address in page.addresses)
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    assert page.tags.count("svg") == 4


def test_the_page_shows_overlays_map_and_side_view(folder):
    text = (folder / "report.html").read_text()
    assert text.count("data:image/jpeg;base64,") == 12 + 3  # overlays, and views of the cloud
    assert text.count("data:image/png;base64,") == 2
    assert "frame 25" in text


def test_a_hostile_name_is_shown_and_not_run(result, tmp_path):
    hostile = "<script>alert(1)</script>\"'&"
    text = (written(renamed(result, hostile), tmp_path) / "report.html").read_text()
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text


def test_the_same_drive_gives_the_same_page(folder, result, tmp_path):
    again = written(result, tmp_path)
    assert (again / "report.html").read_bytes() == (folder / "report.html").read_bytes()
    assert (again / "report.json").read_bytes() == (folder / "report.json").read_bytes()


def test_a_drive_without_gnss_and_truth_says_so(tmp_path):
    result = made_result(tmp_path, gnss=False, truth=False)
    out = tmp_path / "out"
    out.mkdir()
    text = (written(result, out) / "report.html").read_text()
    facts = json.loads((out / "report.json").read_text())
    assert facts["georeference"]["origin"] is None
    assert "truth" not in facts
    assert any("no GNSS" in warning for warning in facts["warnings"])
    assert "own frame" in text
    assert not (out / "trajectory.geojson").exists()
    assert (out / "cloud.laz").exists()


def test_lost_frames_are_warned_of_first(tmp_path):
    facts = drive_facts(made_result(tmp_path, lost=(12,)))
    assert facts["warnings"][0] == (
        "1 of 30 frames were lost (first frame 12: the image is blank) and hold a guess of constant motion; "
        "the track has 2 segments, joined by GNSS or by guesses"
    )
    assert facts["odometry"]["segments"] == 2


def test_what_a_log_need_not_have_is_no_warning(result):
    assert drive_facts(result)["warnings"] == []


def test_labels_of_photographs_by_a_network_of_simulated_streets_are_warned_of(result):
    model = result.model | {"photographs_to_a_network_of_simulated_streets": True}
    (warning,) = drive_facts(replace(result, model=model))["warnings"]
    assert warning.startswith("the network made knows simulated streets only")


@pytest.mark.parametrize(("scale", "told"), [(0.995, False), (0.96, True), (1.03, True)])
def test_odometry_and_fixes_that_contradict_each_other_are_warned_of(result, scale, told):
    report = result.geo.report | {"scale": {"mean": scale, "least": scale, "most": scale, "sigma": 0.001}}
    warnings = drive_facts(replace(result, geo=replace(result.geo, report=report)))["warnings"]
    assert [f"{100 * (scale - 1):+.1f} %" in warning for warning in warnings] == [True] * told


def test_the_row_offset_is_the_largest_in_a_corner(result):
    camera = result.odometry.rig.camera
    x, y = (0 - camera.cx) / camera.fx, (camera.height - 1 - camera.cy) / camera.fy
    by_hand = max(abs(0.1 * (1 + y * y) + 0.2 * sx * x + 6.0 * sx * sy * x * y) for sx in (1, -1) for sy in (1, -1))
    assert row_offset_in_corner(result.odometry) == pytest.approx(by_hand)


def test_numbers_that_json_does_not_know_are_null():
    assert finite({"a": [np.float64("nan"), 1, np.int32(2)], 3: (float("inf"),)}) == {"a": [None, 1, 2], "3": [None]}


def test_numbers_are_written_for_people():
    assert number(None) == "–"
    assert number(1.2345, 2, " m") == "1.23 m"
    assert thousands(1234567) == "1\u202f234\u202f567"


def test_the_cloud_is_shown_raw_with_classes_and_from_the_street(folder, result):
    page = (folder / "report.html").read_text()
    assert page.count("<section>\n  <h2>The cloud</h2>") == 1
    for words in ("as the cameras saw it", "The same with classes", "From the street"):
        assert words in page
    raw, classes, street = cloud_views(result).values()
    assert raw.shape == classes.shape == street.shape
    assert np.abs(raw.astype(int) - classes).max() > 50
    assert cloud_views(replace(result, submaps=[])) == {}
