"""The map in other viewers: CesiumJS and deck.gl draw its 3D tiles, MapLibre its style, GDAL its pictures and vector tiles."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from service_kit.browsers import chromium, pixels_by_class, shot, site
from service_kit.javascript import packages
from service_kit.made_version import served_map
from service_kit.programs import needed
from service_kit.running import ApiAlone, until
from tiles.made_maps import made_map, made_tracks
from wayloom.config.classes import CLASS_NAMES
from wayloom.tiles.grid import TILE_PX, pixel_from_lonlat
from wayloom.tiles.settings import TileSettings

CESIUM = """<!doctype html><body style="margin:0"><div id=view style="width:600px;height:450px"></div>
<script>window.CESIUM_BASE_URL = "/node_modules/cesium/Build/Cesium/"</script>
<script src="/node_modules/cesium/Build/Cesium/Cesium.js"></script>"""
DECK = """<!doctype html><body style="margin:0"><div id=view style="width:600px;height:450px;position:relative"></div>
<script src="/node_modules/deck.gl/dist.min.js"></script>
<script src="/node_modules/@loaders.gl/3d-tiles/dist/dist.min.js"></script>"""
MAPLIBRE = """<!doctype html><body style="margin:0"><div id=view style="width:600px;height:450px"></div>"""
SHOW_IN_CESIUM = """async (url) => {
  const widget = new Cesium.CesiumWidget("view", { baseLayer: false, globe: false, skyBox: false, skyAtmosphere: false });
  widget.canvas.style.cssText = "width:600px;height:450px";
  widget.resize();
  widget.scene.backgroundColor = Cesium.Color.WHITE;
  const tileset = await Cesium.Cesium3DTileset.fromUrl(url);
  tileset.pointCloudShading.attenuation = true;
  tileset.pointCloudShading.maximumAttenuation = 4;
  tileset.style = new Cesium.Cesium3DTileStyle({ show: "${name} !== 'pole'" });
  widget.scene.primitives.add(tileset);
  const { radius } = tileset.boundingSphere;
  widget.camera.viewBoundingSphere(tileset.boundingSphere, new Cesium.HeadingPitchRange(0, -1, 2 * radius));
  Object.assign(globalThis, { widget, tileset });
}"""
SHOW_IN_DECK = """async (url) => {
  const { glTFPointsLayer } = await import(`${new URL(url).origin}/static/deck-points.js`);
  globalThis.failed = [];
  globalThis.view = new deck.Deck({
    parent: document.getElementById("view"), views: new deck.MapView(), initialViewState: { longitude: 0, latitude: 0, zoom: 1 },
    layers: [new deck.Tile3DLayer({
      id: "map", data: url, loader: loaders.Tiles3DLoader, onTileError: (tile, message) => failed.push(message),
      _subLayerProps: { scenegraph: { type: glTFPointsLayer(deck), pointSize: 3 } },
      onTilesetLoad: (tileset) => {
        globalThis.tileset = tileset;
        const [longitude, latitude] = tileset.cartographicCenter;
        view.setProps({ initialViewState: { longitude, latitude, zoom: 17.5, pitch: 30 } });
      },
    })],
  });
}"""
SHOW_IN_MAPLIBRE = """async (style) => {
  const maplibre = await import("/vendor/maplibre-gl/maplibre-gl.mjs");
  const map = new maplibre.Map({ container: "view", style, fadeDuration: 0 });
  globalThis.failed = [];
  map.on("error", (event) => failed.push(event.error.message));
  await map.once("load");
  map.jumpTo({ zoom: 17.5 });
  await map.once("idle");
  return [map.getZoom(), map.queryRenderedFeatures({ layers: ["coverage"] }).length, failed];
}"""


@dataclass(frozen=True)
class Shown:
    """A served map, a site of another origin whose pages show it, and a browser."""

    api: ApiAlone
    origin: str
    browser: Any

    @property
    def url(self) -> str:
        return f"{self.api.url}/v1/maps/city"


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    """A square of 120 m, its 3D tiles small, so that they are many."""
    city = made_map(6000, extent_m=60.0)
    data = tmp_path_factory.mktemp("viewers") / "data"
    with closing(
        served_map(data, city, made_tracks(city), TileSettings(cloud_points_per_tile=1000), WAYLOOM_CORS_ORIGINS="*")
    ) as alone:
        yield alone


@pytest.fixture(scope="module")
def shown(api: ApiAlone) -> Iterator[Shown]:
    pages = {"/cesium.html": CESIUM, "/deck.html": DECK}
    with chromium() as browser, site(packages(), pages) as origin:
        yield Shown(api, origin, browser)


def opened(shown: Shown, address: str, said: list[str]) -> Any:
    page = shown.browser.new_page(viewport={"width": 600, "height": 450})
    page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(address)
    return page


def errors(said: list[str]) -> list[str]:
    """Without what a browser says of a site that has no icon."""
    return [one for one in said if "404 (File not found)" not in one]


@pytest.mark.browser
def test_cesium_draws_the_tileset_in_the_colours_of_its_classes_and_knows_their_names(shown: Shown) -> None:
    said: list[str] = []
    page = opened(shown, f"{shown.origin}/cesium.html", said)
    page.evaluate(SHOW_IN_CESIUM, f"{shown.url}/3dtiles/tileset.json")
    until(lambda: page.evaluate("tileset.tilesLoaded && tileset.statistics.numberOfPointsSelected > 3000"), 60)
    until(lambda: sum(pixels_by_class(shot(page)).values()) > 10_000, 60)
    found = pixels_by_class(shot(page))
    assert {name for name in ("road", "sidewalk", "building", "vegetation", "terrain") if found[name] > 100} == {
        "road", "sidewalk", "building", "vegetation", "terrain",
    }  # fmt: skip
    assert found["pole"] < 0.05 * found["terrain"]  # hidden by a style that asks for the name of the class
    picked = page.evaluate(
        """() => {
          for (let x = 60; x < 540; x += 6) for (let y = 60; y < 400; y += 6) {
            const feature = widget.scene.pick(new Cesium.Cartesian2(x, y));
            const name = feature?.getProperty?.("name");
            if (name) return [name, feature.getProperty("voxels"), feature.featureId];
          }
        }"""
    )
    assert CLASS_NAMES[picked[2]] == picked[0]
    assert picked[1] > 0
    assert errors(said) == []
    page.close()


@pytest.mark.browser
def test_deck_gl_draws_the_tileset_with_our_layer_for_points(shown: Shown) -> None:
    said: list[str] = []
    page = opened(shown, f"{shown.origin}/deck.html", said)
    page.evaluate(SHOW_IN_DECK, f"{shown.url}/3dtiles/tileset.json")
    until(lambda: sum(pixels_by_class(shot(page)).values()) > 10_000, 60)
    until(lambda: page.evaluate("tileset.isLoaded()"), 60)
    found = pixels_by_class(shot(page))
    assert min(found[name] for name in ("road", "sidewalk", "building", "vegetation", "terrain")) > 500
    assert (page.evaluate("failed"), errors(said)) == ([], [])
    page.close()


@pytest.mark.browser
def test_maplibre_loads_the_style_and_draws_its_pictures_and_lines(shown: Shown) -> None:
    said: list[str] = []
    with site(Path(str(files("wayloom_services"))) / "static", {"/maplibre.html": MAPLIBRE}) as origin:
        page = opened(shown, f"{origin}/maplibre.html", said)
        zoom, tracks, failed = page.evaluate(SHOW_IN_MAPLIBRE, f"{shown.url}/style.json")
        assert (zoom, failed, errors(said)) == (17.5, [], [])
        assert tracks > 0
        assert (np.ptp(shot(page).astype(int), axis=2) > 40).mean() > 0.05  # coloured, not paper
        page.close()


def gdal(*command: str, folder: Path) -> str:
    """What a tool of GDAL says, all of it. None on the machine is a failure in CI and a skip elsewhere."""
    needed(command[0], "gdal-bin")
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def tms(url: str, zoom: int, edge: int = 256) -> str:
    """A file that GDAL's driver of tiled web maps reads."""
    half = 20_037_508.342789244
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{url}</ServerUrl></Service><DataWindow><UpperLeftX>-{half}</UpperLeftX>'
        f"<UpperLeftY>{half}</UpperLeftY><LowerRightX>{half}</LowerRightX><LowerRightY>-{half}</LowerRightY><TileLevel>{zoom}"
        f"</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY><YOrigin>top</YOrigin></DataWindow><Projection>EPSG:3857"
        f"</Projection><BlockSizeX>{edge}</BlockSizeX><BlockSizeY>{edge}</BlockSizeY><BandsCount>4</BandsCount></GDAL_WMS>"
    )


@pytest.mark.parametrize(("edge", "suffix"), [(256, ""), (512, "@2x")])
def test_gdal_reads_pictures_without_a_message_where_tiles_are_empty_too(
    api: ApiAlone, tmp_path: Path, edge: int, suffix: str
) -> None:
    (tmp_path / "map.xml").write_text(tms(f"{api.url}/v1/maps/city/tiles/semantic/${{z}}/${{x}}/${{y}}{suffix}.png", 18, edge))
    west, south, east, north = httpx2.get(f"{api.url}/v1/maps/city").json()["bounds"]
    wide = [str(one) for one in (west - 0.004, north + 0.002, east + 0.004, south - 0.002)]
    command = ("gdal_translate", "-q", "-projwin", *wide, "-projwin_srs", "EPSG:4326", "-outsize", "700", "0", "map.xml", "map.png")
    gdal(*command, folder=tmp_path)
    said = json.loads(gdal("gdalinfo", "-json", "-stats", "map.png", folder=tmp_path))
    alpha = said["bands"][3]
    assert (alpha["minimum"], alpha["maximum"]) == (0.0, 255.0)


def test_gdal_reads_vector_tiles_without_a_message(api: ApiAlone, tmp_path: Path) -> None:
    described = httpx2.get(f"{api.url}/v1/maps/city/tiles/features/tilejson.json").json()
    column, row = (pixel_from_lonlat(np.array([[8.39, 48.98]]), 18)[0] // TILE_PX).tolist()
    address = described["tiles"][0].format(z=18, x=column, y=row)
    layers = gdal("ogrinfo", "-ro", "-so", "-al", f"MVT:{address}", folder=tmp_path)
    assert "Layer name: semantic" in layers
    assert "Layer name: coverage" in layers
