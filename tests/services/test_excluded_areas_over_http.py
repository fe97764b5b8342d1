"""Excluded areas over HTTP and from the command line."""

import json
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from service_kit.running import ApiAlone, environment
from wayloom.config.retention import MAX_AREAS

YARD = {"type": "Polygon", "coordinates": [[[8.4, 49.0], [8.41, 49.0], [8.41, 49.01], [8.4, 49.0]]]}


def areas(api: ApiAlone, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "wayloom.cli.main", "areas", *arguments, "--to", api.url]
    return subprocess.run(command, env=environment(), capture_output=True, text=True)


def test_areas_are_added_listed_and_removed(http: httpx2.Client) -> None:
    feature = {"type": "Feature", "properties": {"name": "yard"}, "geometry": YARD}
    added = http.post("/v1/excluded-areas", json=feature)
    assert added.status_code == 201
    (one,) = added.json()["features"]
    assert one["geometry"] == YARD
    assert {name: one["properties"][name] for name in ("name", "source", "since_version")} == {
        "name": "yard", "source": "service", "since_version": None,
    }  # fmt: skip
    assert http.get("/v1/excluded-areas").json()["features"] == [one]
    assert http.delete(f"/v1/excluded-areas/{one['id']}").status_code == 204
    assert http.delete(f"/v1/excluded-areas/{one['id']}").status_code == 404
    assert http.get("/v1/excluded-areas").json()["features"] == []


@pytest.mark.parametrize("body", [b"", b"[", b"{}", b'{"type": "Point", "coordinates": [8, 49]}', b"[" * 100_000])
def test_a_body_that_is_no_area_is_refused(http: httpx2.Client, body: bytes) -> None:
    answer = http.post("/v1/excluded-areas", content=body)
    assert (answer.status_code, answer.json()["code"]) == (400, "bad-input")


def test_a_third_coordinate_that_is_no_number_is_not_stored(http: httpx2.Client) -> None:
    body = json.dumps(YARD).replace("[8.41, 49.0]", "[8.41, 49.0, NaN]")
    added = http.post("/v1/excluded-areas", content=body)
    assert added.status_code == 201
    (one,) = added.json()["features"]
    assert one["geometry"] == YARD
    assert http.delete(f"/v1/excluded-areas/{one['id']}").status_code == 204


def test_a_request_of_too_many_areas_is_refused(http: httpx2.Client) -> None:
    feature = {"type": "Feature", "properties": {}, "geometry": YARD}
    answer = http.post("/v1/excluded-areas", json={"type": "FeatureCollection", "features": [feature] * (MAX_AREAS + 1)})
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
    assert http.get("/v1/excluded-areas").json()["features"] == []


def test_operators_exclude_areas_from_the_command_line(api_process: ApiAlone, tmp_path: Path) -> None:
    file = tmp_path / "yard.geojson"
    file.write_text(json.dumps({"type": "Feature", "properties": {"name": "depot"}, "geometry": YARD}))
    assert areas(api_process, "add", str(file)).returncode == 2  # nobody is there to be asked
    added = areas(api_process, "add", str(file), "--yes")
    assert (added.returncode, added.stdout.endswith("depot\n")) == (0, True)
    assert "being excluded" in areas(api_process, "list").stdout
    assert areas(api_process, "remove", "depot").returncode == 0
    assert areas(api_process, "list").stdout == "no excluded areas\n"
    assert areas(api_process, "remove", "depot").returncode == 1
    file.write_text("{}")
    refused = areas(api_process, "add", str(file), "--yes")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert refused.stderr.startswith(f"wayloom: {file}: is no area: ")
