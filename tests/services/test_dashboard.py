"""The dashboard in a real browser: it shows map, drives and errors, follows what changes, and says nothing on the console."""

import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from service_kit import little_stages
from service_kit.guarded import API_KEY, PASSWORD, Guarded
from service_kit.little_stages import held_up
from service_kit.packed_drives import packed_drive
from service_kit.running import ApiAlone, service, until
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.config.roles import Role
from wayloom.store import maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.tiles import protobuf
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.png import png_bytes
from wayloom.tiles.rasters import RASTER_LAYERS

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
SHOWN = "!!globalThis.wayloomMap?.getLayer('semantic') && wayloomMap.loaded() && !wayloomMap.isMoving()"


@pytest.fixture
def browser() -> Iterator[Any]:
    if not CHROMIUM.exists():
        if os.environ.get("CI"):
            pytest.fail(f"no {CHROMIUM}: install Debian's chromium")
        pytest.skip(f"no {CHROMIUM}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(ARGUMENTS))
        yield launched
        launched.close()


@pytest.mark.browser
def test_the_dashboard_shows_map_and_drives_and_follows_them(browser: Any, tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api, url = up.api(), up.url
        first = upload(api, packed_drive(tmp_path / "a", "first drive"))["id"]
        wait_for_drive(api, first)
        page = browser.new_page(viewport={"width": 1200, "height": 750})
        said: list[str] = []
        tiles: list[int] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("response", lambda answer: tiles.append(answer.status) if "/tiles/semantic/" in answer.url else None)
        page.on(
            "request", lambda request: said.append(request.url) if not request.url.startswith((url, "blob:", "data:")) else None
        )
        page.goto(url)
        page.wait_for_selector(f"[data-id='{first}'][data-state=done]")
        until(lambda: page.evaluate(SHOWN) and 200 in tiles)
        assert page.inner_text("#version") == "city · version 1"
        assert not page.is_checked("#show-parked")
        assert page.evaluate("wayloomMap.getLayoutProperty('parked', 'visibility')") == "none"
        with page.expect_response(lambda answer: "/tiles/parked/" in answer.url):
            page.click("#show-parked")
        assert page.evaluate("wayloomMap.getLayoutProperty('parked', 'visibility')") == "visible"
        assert page.evaluate("!wayloomMap.getLayer('unconfirmed')")  # nothing is: no layer
        assert page.inner_text("#live") == "live"
        assert page.evaluate("wayloomMap.getZoom()") > 14
        assert page.evaluate("wayloomMap.queryRenderedFeatures({layers: ['tracks']}).length") > 0

        bad = upload(api, packed_drive(tmp_path / "b", "broken drive", {"odometry": {"bad": True}}))["id"]
        page.wait_for_selector(f"[data-id='{bad}'] .error")
        assert "record it again" in page.inner_text(f"[data-id='{bad}'] .error")
        with held_up(up.data, "odometry"):
            slow = upload(api, packed_drive(tmp_path / "c", "slow drive"))["id"]
            page.wait_for_selector(f"[data-id='{slow}'][data-state=running]")
            until(lambda: "odometry" in page.inner_text(f"[data-id='{slow}'] .words"))
        page.wait_for_selector(f"[data-id='{slow}'][data-state=done]")
        until(lambda: page.inner_text("#version") == "city · version 2")
        until(lambda: page.evaluate(SHOWN))
        page.click("#show-coverage")
        page.click("#fit")
        until(
            lambda: page.evaluate("!wayloomMap.isMoving() && wayloomMap.queryRenderedFeatures({layers: ['coverage']}).length > 0")
        )
        api.once("DELETE", f"/v1/drives/{bad}")
        page.wait_for_selector(f"[data-id='{bad}']", state="detached")
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_dashboard_opens_on_the_photograph_where_a_version_has_one(browser: Any, tmp_path: Path) -> None:
    """Below the classes, in tiles of 512 pixels; a version without one has no box to tick."""
    with closing(ApiAlone(tmp_path / "data")) as alone:
        picture = np.full((512, 512, 4), (200, 40, 40, 255), np.uint8)
        photo, clear = RASTER_LAYERS["ortho"].codec.encode(picture), png_bytes(np.zeros((256, 256, 4), np.uint8))
        publish_tiles(alone, {"semantic": (clear, "image/png")})
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(alone.url)
        until(lambda: page.evaluate(SHOWN))
        assert not page.is_visible("#show-ortho")
        with page.expect_response(lambda answer: "/tiles/ortho/" in answer.url and answer.status == 200) as found:
            publish_tiles(alone, {"ortho": (photo, "image/webp")})
        assert found.value.headers["content-type"] == "image/webp"
        assert found.value.url.endswith(".webp")
        until(lambda: page.is_visible("#show-ortho") and page.evaluate(SHOWN))
        order = page.evaluate("wayloomMap.getStyle().layers.map((layer) => layer.id)")
        assert order.index("grid") < order.index("ortho") < order.index("semantic") < order.index("tracks")
        assert page.evaluate("wayloomMap.getSource('ortho').tileSize") == 512
        until(lambda: red_share(page) > 0.02)
        page.click("#show-ortho")
        until(lambda: red_share(page) < 0.001)
        assert said == []
        page.close()


def red_share(page: Any) -> float:
    """Of the pixels of the page."""
    shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR).astype(int)
    return float(((shot[..., 2] > 150) & (shot[..., 1] < 90) & (shot[..., 0] < 90)).mean())


def publish_tiles(alone: ApiAlone, layers: dict[str, tuple[bytes, str]]) -> None:
    """The next version: one tile of each layer at the zooms 12 to 18, all over the same place."""
    blobs, database = BlobStore(alone.data / "blobs"), Database(f"sqlite:///{alone.data / 'wayloom.db'}")
    tiles = []
    for layer, (content, media_type) in layers.items():
        digest = blobs.put(content)
        spots = (little_stages.tile(zoom, digest, len(content)) for zoom in range(12, 19))
        tiles += [TileEntry(**{**spot, "layer": layer, "media_type": media_type}) for spot in spots]  # type: ignore[arg-type]
    bounds = (little_stages.LON, little_stages.LAT, little_stages.LON + 0.001, little_stages.LAT + 0.001)
    with database.write() as session:
        base = maps.ensure_map(session, "city").version
        publish(session, "city", NewVersion(base, (8.5, 49.5, 0.0), (), 1, bounds, tiles), kept=5)
    database.close()


@pytest.mark.browser
def test_the_page_of_a_held_drive_tells_why_and_an_operator_releases_it_there(browser: Any, tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api, url = up.api(), up.url
        held = upload(api, packed_drive(tmp_path / "a", "narrow street", {"grade": "D"}))["id"]
        wait_for_drive(api, held)
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(url)
        page.wait_for_selector(f"[data-id='{held}'][data-state=held]")
        assert "grade D: sigma of the position 2.00 m" in page.inner_text(f"[data-id='{held}'] .words")
        assert page.inner_text(f"[data-id='{held}'] .grade") == "D"
        page.click(f"[data-id='{held}'] .report")
        page.wait_for_selector("img.plot")
        until(lambda: page.evaluate("document.querySelector('img.plot').naturalWidth") == 80)
        assert page.inner_text("#verdict") == "Grade D by its own GNSS, held: it waits for drives that place it, or an operator"
        page.fill("#by", "Ada")
        page.fill("#why", "checked against the plan")
        page.click("#ask-release button")
        until(lambda: page.is_visible("#revoke"))
        assert not page.is_visible("#ask-release")
        assert "Released by Ada" in page.inner_text("#release")
        assert wait_for_drive(api, held)["state"] == "done"
        page.reload()
        with held_up(up.data, "stitch"):
            page.click("#reprocess")
            page.click("dialog .primary")
            page.wait_for_selector("#anew:not([hidden])")
            assert "This page shows the result before" in page.inner_text("#anew")
        until(lambda: api.drive(held)["reprocess"] is None)
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_dashboard_takes_a_key_where_the_server_wants_one(browser: Any, tmp_path: Path) -> None:
    with service(tmp_path / "data", WAYLOOM_API_KEY=API_KEY) as up:
        page = browser.new_page()
        page.goto(up.url)
        page.wait_for_url("**/sign-in?next=%2F")
        page.click("summary")
        page.fill("#key", "no such key")
        page.click("#with-key button")
        page.wait_for_selector("#problem:not([hidden])")
        page.fill("#key", API_KEY)
        page.click("#with-key button")
        until(lambda: page.inner_text("#live") == "live")
        assert page.inner_text("#who") == "api key"
        page.close()


@pytest.mark.browser
def test_an_operator_signs_in_sees_tiles_and_events_by_the_cookie_alone_and_signs_out(browser: Any, tmp_path: Path) -> None:
    guarded = Guarded(tmp_path / "data")
    guarded.user("anna", Role.OPERATOR)
    with closing(guarded):
        publish_tiles(guarded.api, {"semantic": (png_bytes(np.zeros((256, 256, 4), np.uint8)), "image/png")})
        page = browser.new_page()
        said: list[str] = []
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(f"{guarded.api.url}/drives/{'0' * 64}")
        page.wait_for_url("**/sign-in?next=*")
        for password in ("not the password", PASSWORD):
            page.fill("#name", "anna")
            page.fill("#password", password)
            page.click("#sign-in button")
            page.wait_for_selector("#problem:not([hidden])" if password != PASSWORD else "#sign-out")
        assert page.url.endswith("/drives/" + "0" * 64)  # back where it came from
        page.goto(guarded.api.url)
        until(lambda: page.inner_text("#live") == "live" and page.evaluate(SHOWN))
        assert page.inner_text("#who") == "anna"
        assert page.evaluate("document.cookie") == ""
        assert page.evaluate("sessionStorage.length") == 0
        assert page.evaluate("fetch('/v1/maps/city/tiles/semantic/0/0/0.png').then((answer) => answer.status)") in (200, 204)
        page.click("#sign-out")
        page.wait_for_url("**/sign-in")
        assert page.evaluate("fetch('/v1/maps').then((answer) => answer.status)") == 401
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_dashboard_draws_markings_and_kerbs_near_the_ground(browser: Any, tmp_path: Path) -> None:
    """From zoom 18, over the classes; a version without any has no box to tick."""
    with closing(ApiAlone(tmp_path / "data")) as alone:
        clear = png_bytes(np.zeros((256, 256, 4), np.uint8))
        publish_tiles(alone, {"semantic": (clear, "image/png")})
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(alone.url)
        until(lambda: page.evaluate(SHOWN))
        assert not page.is_visible("#show-markings")
        lines = {
            name: [(protobuf.line([(0, at), (4096, at)]), {"kind": name})] for name, at in (("markings", 1500), ("kerbs", 2500))
        }
        tile = b"".join(protobuf.layer(name, 4096, protobuf.LINE, features) for name, features in lines.items())
        publish_tiles(alone, {"markings": (tile, TILE_FORMATS["mvt"].media_type)})
        until(lambda: page.is_visible("#show-markings") and page.evaluate(SHOWN))
        order = page.evaluate("wayloomMap.getStyle().layers.map((layer) => layer.id)")
        assert order.index("semantic") < order.index("kerbs") < order.index("markings") < order.index("tracks")
        drawn = "wayloomMap.queryRenderedFeatures({layers: ['markings', 'kerbs']}).map((one) => one.properties.kind)"
        page.evaluate("wayloomMap.jumpTo({zoom: 18.2})")
        until(lambda: {*page.evaluate(drawn)} == {"markings", "kerbs"})
        page.click("#show-markings")
        until(lambda: page.evaluate(drawn) == [])
        page.click("#show-markings")
        page.evaluate("wayloomMap.jumpTo({zoom: 17.5})")
        until(lambda: page.evaluate(SHOWN))
        assert page.evaluate(drawn) == []
        assert said == []
        page.close()


@pytest.mark.browser
def test_the_dashboard_draws_objects_that_tell_of_themselves_and_areas_where_asked_for(browser: Any, tmp_path: Path) -> None:
    with closing(ApiAlone(tmp_path / "data")) as alone:
        pole = {"id": "0.0.pole-1", "kind": "pole", "height_m": 4.25, "confidence": 0.98, "drive_count": 3}
        poles = [(protobuf.point(256 + 512 * k, 256 + 512 * row), pole) for k in range(8) for row in range(8)]
        objects = protobuf.layer("objects", 4096, protobuf.POINT, poles)
        square = [(400, 400), (3700, 400), (3700, 3700), (400, 3700)]
        areas = protobuf.layer("areas", 4096, protobuf.POLYGON, [(protobuf.polygon([square]), {"kind": "road"})])
        of = TILE_FORMATS["mvt"].media_type
        clear = png_bytes(np.zeros((256, 256, 4), np.uint8))
        publish_tiles(alone, {"semantic": (clear, "image/png"), "objects": (objects, of), "areas": (areas, of)})
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(alone.url)
        until(lambda: page.evaluate(SHOWN))
        drawn = "wayloomMap.queryRenderedFeatures({layers: ['objects', 'areas']}).map((one) => one.properties.kind)"
        page.evaluate("wayloomMap.jumpTo({zoom: 18.2})")
        until(lambda: {*page.evaluate(drawn)} == {"pole"})
        page.click("#show-areas")
        until(lambda: {*page.evaluate(drawn)} == {"pole", "road"})
        if folder := os.environ.get("WAYLOOM_SHOTS"):
            page.screenshot(path=f"{folder}/objects.png")
        page.evaluate(
            "wayloomMap.jumpTo({center: wayloomMap.queryRenderedFeatures({layers: ['objects']})[0].geometry.coordinates})"
        )
        until(lambda: page.evaluate(SHOWN))
        box = page.locator(".maplibregl-canvas").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0)
        until(lambda: page.locator(".about").count() == 1)
        told = page.inner_text(".about")
        assert "0.0.pole-1" in told
        assert "4.25" in told
        page.click("#show-objects")
        until(lambda: {*page.evaluate(drawn)} == {"road"})
        assert said == []
        page.close()
