"""Tiles as GDAL reads them: what is mapped is there, and empty places are silent."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from service_kit.programs import needed
from service_kit.published_tiles import PublishedMap
from service_kit.running import ApiAlone

ZOOM = 3
EARTH_M = 20037508.342789244
DESCRIPTION = """<GDAL_WMS>
 <Service name="TMS"><ServerUrl>{url}/v1/maps/city/tiles/semantic/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
 <DataWindow><UpperLeftX>-{edge}</UpperLeftX><UpperLeftY>{edge}</UpperLeftY><LowerRightX>{edge}</LowerRightX>
  <LowerRightY>-{edge}</LowerRightY><TileLevel>{zoom}</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>
  <YOrigin>top</YOrigin></DataWindow>
 <Projection>EPSG:3857</Projection><BlockSizeX>256</BlockSizeX><BlockSizeY>256</BlockSizeY><BandsCount>4</BandsCount>
</GDAL_WMS>"""


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service with one tile, all of it (10, 20, 30)."""
    alone = ApiAlone(tmp_path_factory.mktemp("service"))
    city = PublishedMap(alone.data)
    tile = np.full((256, 256, 4), (30, 20, 10, 255), np.uint8)
    city.publish({("semantic", ZOOM, 4, 2): cv2.imencode(".png", tile)[1].tobytes()})
    yield alone.url
    city.database.close()
    alone.close()


def test_gdal_reads_the_tiles_and_takes_empty_places_without_a_word(url: str, tmp_path: Path) -> None:
    needed("gdal_translate", "gdal-bin")
    (tmp_path / "city.xml").write_text(DESCRIPTION.format(url=url, edge=EARTH_M, zoom=ZOOM))
    command = ["gdal_translate", "-q", "-of", "PNG", "-srcwin", "768", "512", "512", "256", "city.xml", "out.png"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    picture = cv2.imread(str(tmp_path / "out.png"), cv2.IMREAD_UNCHANGED)
    assert (picture[:, :256] == 0).all()  # a place without a tile: 204
    assert (picture[:, 256:] == (30, 20, 10, 255)).all()
