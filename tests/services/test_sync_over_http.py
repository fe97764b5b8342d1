"""The differences of two versions, and what a client that holds tiles lacks, over HTTP."""

from collections.abc import Iterator

import httpx2
import pytest

from service_kit.published_tiles import PublishedMap, Tiles
from services.conftest import ApiAlone

FIRST: Tiles = {("semantic", 4, x, 3): bytes([x]) for x in range(6)} | {("points", 4, 1, 3): b"points"}
SECOND: Tiles = {**FIRST, ("semantic", 4, 2, 3): b"two", ("semantic", 4, 9, 3): b"nine"}
del SECOND["points", 4, 1, 3]


@pytest.fixture(scope="module", autouse=True)
def city(api_process: ApiAlone) -> Iterator[PublishedMap]:
    made = PublishedMap(api_process.data, "differing")
    made.publish(FIRST)
    made.publish(SECOND)
    yield made
    made.database.close()


def where(tiles: list[dict[str, object]]) -> list[tuple[object, ...]]:
    return [(tile["layer"], tile["z"], tile["x"], tile["y"]) for tile in tiles]


def test_a_diff_lists_what_came_changed_and_went_and_both_ways_round(http: httpx2.Client) -> None:
    forth = http.get("/v1/maps/differing/diff/1/2").json()
    assert (forth["base"], forth["version"], forth["next"]) == (1, 2, None)
    assert where(forth["added"]) == [("semantic", 4, 9, 3)]
    assert where(forth["changed"]) == [("semantic", 4, 2, 3)]
    assert where(forth["removed"]) == [("points", 4, 1, 3)]
    back = http.get("/v1/maps/differing/diff/2/1").json()
    assert (where(back["added"]), where(back["removed"])) == (where(forth["removed"]), where(forth["added"]))
    assert back["changed"][0]["digest"] == forth["changed"][0]["before"]
    assert (forth["added"][0]["bytes"], forth["changed"][0]["bytes"]) == (4, 3)
    same = http.get("/v1/maps/differing/diff/2/2").json()
    assert same["added"] == same["changed"] == same["removed"] == []


def test_a_diff_comes_in_pages_and_of_chosen_layers_and_boxes(http: httpx2.Client) -> None:
    found, after = [], {}
    for _ in range(20):
        page = http.get("/v1/maps/differing/diff/0/1", params={"limit": "2", **after}).json()
        assert len(page["added"]) <= 2
        found += where(page["added"])
        if page["next"] is None:
            break
        after = {"after": page["next"]}
    assert found == sorted(FIRST)
    points = http.get("/v1/maps/differing/diff/0/1", params={"layers": "points"}).json()
    assert where(points["added"]) == [("points", 4, 1, 3)]
    box = http.get("/v1/maps/differing/diff/0/1", params={"bbox": "-179,-80,-160,80", "layers": "semantic"}).json()
    assert where(box["added"]) == [("semantic", 4, 0, 3)]


def test_a_client_that_says_its_version_gets_what_to_fetch_and_drop(http: httpx2.Client) -> None:
    page = http.post("/v1/maps/differing/sync", json={"version": 1}).json()
    assert (page["version"], page["base"], page["next"]) == (2, 1, None)
    assert [tile["name"] for tile in page["add"]] == ["semantic/4/9/3.png"]
    assert [tile["name"] for tile in page["replace"]] == ["semantic/4/2/3.png"]
    assert [tile["name"] for tile in page["drop"]] == ["points/4/1/3.wlp"]
    for tile in (*page["add"], *page["replace"]):
        answer = http.get(page["fetch_from"] + tile["name"])
        assert answer.content == SECOND[tile["layer"], tile["z"], tile["x"], tile["y"]]
        assert answer.headers["etag"] == f'"{tile["digest"]}"'
        assert "immutable" in answer.headers["cache-control"]


def test_a_client_whose_version_nobody_knows_gets_all_and_is_told(http: httpx2.Client) -> None:
    page = http.post("/v1/maps/differing/sync", json={"version": 77}).json()
    assert (page["base"], page["replace"], page["drop"]) == (0, [], [])
    assert where(page["add"]) == sorted(SECOND)


def test_a_client_may_say_the_tiles_that_it_holds_instead(http: httpx2.Client) -> None:
    listed = http.get("/v1/maps/differing/diff/0/1", params={"layers": "semantic"}).json()["added"]
    held = [{name: tile[name] for name in ("layer", "z", "x", "y", "digest")} for tile in listed[:4]]
    page = http.post("/v1/maps/differing/sync", json={"tiles": [*held, {**held[0], "x": 15}], "layers": ["semantic"]}).json()
    assert page["base"] is None
    assert where(page["add"]) == [("semantic", 4, x, 3) for x in (4, 5, 9)]
    assert where(page["replace"]) == [("semantic", 4, 2, 3)]
    assert where(page["drop"]) == [("semantic", 4, 15, 3)]


def test_regions_that_differ_are_listed(http: httpx2.Client) -> None:
    assert http.get("/v1/maps/differing/diff/1/2/regions").json() == {
        "map_id": "differing", "base": 1, "version": 2, "regions": [], "next": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"version": 1, "tiles": []}, 400),
        ({"version": -1}, 422),
        ({"layers": ["meadows"]}, 400),
        ({"bbox": [0.0, 1.0, 2.0, -5.0]}, 400),
        ({"bbox": [0.0, 1.0]}, 422),
        ({"tiles": [{"layer": "semantic", "z": 1, "x": 0, "y": 0, "digest": "12"}]}, 422),
        ({"after": "semantic;4"}, 422),
        ({"hold": 3}, 422),
        ({"to": 9}, 404),
    ],
)
def test_a_request_that_says_nothing_sensible_is_refused(http: httpx2.Client, body: dict[str, object], status: int) -> None:
    assert http.post("/v1/maps/differing/sync", json=body).status_code == status


def test_versions_and_maps_that_are_not_there_have_no_differences(http: httpx2.Client) -> None:
    for path in ("differing/diff/1/9", "differing/diff/9/1", "nowhere/diff/0/1", "differing/diff/9/1/regions"):
        assert http.get(f"/v1/maps/{path}").status_code == 404
    assert http.post("/v1/maps/nowhere/sync", json={}).status_code == 404
    assert http.get("/v1/maps/differing/diff/0/1", params={"layers": "meadows"}).status_code == 400
