"""The ground of several drives as GeoTIFF, asked by GDAL at places whose height and colour are known."""

import json
import subprocess

import numpy as np
import pytest

from exports.made_sources import made_source
from ground.made_sheets import Street
from service_kit.programs import needed
from wayloom.errors import InputError
from wayloom.exports.cog import write_ground_cog
from wayloom.geodesy import wgs84


@pytest.fixture(scope="module")
def files(street, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cog")
    for layer in ("ortho", "height"):
        write_ground_cog(folder / f"{layer}.tif", street, None, layer, street.provenance())
    return folder


def gdal(*arguments, **more):
    needed("gdallocationinfo", "gdal-bin")
    done = subprocess.run([*map(str, arguments)], capture_output=True, text=True, check=True, **more)
    return done.stdout


def asked(file, street, enu):
    """(N, bands) values that GDAL gives at places (N, 3) m in the map's frame."""
    utm = wgs84.utm_from_lonlatheight(wgs84.lonlatheight_from_enu(enu, street.frame), 32632)
    lines = "".join(f"{x!r} {y!r}\n" for x, y, _ in utm.tolist())
    text = gdal("gdallocationinfo", "-valonly", "-geoloc", file, input=lines)
    return np.array(text.split(), float).reshape(len(enu), -1)


def places(count=200):
    """On the street, away from its kerbs, its ends and the edges of its paint."""
    made, rng = Street(), np.random.default_rng(2)
    x, y = rng.uniform(5.0, 67.0, count), made.middle_m + rng.uniform(-3.5, 3.5, count)
    return made, np.column_stack([x, y, made.height(x, y)])


def test_heights_are_those_of_the_street_above_the_ellipsoid(files, street):
    _, enu = places()
    truth = wgs84.lonlatheight_from_enu(enu, street.frame)[:, 2]
    error = asked(files / "height.tif", street, enu)[:, 0] - truth
    slope = np.hypot(0.02, 0.01) * 0.1 / np.sqrt(2.0)  # a cell is asked for at most so far from its middle
    assert np.abs(error).max() < slope + 0.01  # a sheet's heights are whole millimetres, two are averaged; its noise is below 3 mm


def test_the_photograph_lies_where_the_paint_is(files, street):
    made = Street()
    x = np.arange(6.0, 66.0, 6.0)
    on, off = x + 1.5, x + 4.5  # middle of a dash, middle of the gap
    for along, bright in ((on, True), (off, False)):
        enu = np.column_stack([along, np.full(len(x), made.middle_m), made.height(along, np.full(len(x), made.middle_m))])
        rgba = asked(files / "ortho.tif", street, enu)
        assert (rgba[:, 3] == 255).all()
        assert ((rgba[:, 0] > 170) == bright).all()


def test_gdal_reads_the_system_the_overviews_and_the_provenance(files, street):
    about = json.loads(gdal("gdalinfo", "-json", files / "ortho.tif"))
    assert 'ID["EPSG",32632]' in about["coordinateSystem"]["wkt"]
    assert about["metadata"][""]["AREA_OR_POINT"] == "Area"
    assert json.loads(about["metadata"][""]["provenance"]) == street.provenance()
    assert abs(about["geoTransform"][1] - 0.05) < 1e-12
    assert [band["colorInterpretation"] for band in about["bands"]] == ["Red", "Green", "Blue", "Alpha"]
    assert len(about["bands"][0]["overviews"]) >= 1


def test_a_box_cuts_the_picture(street, tmp_path):
    _, enu = places()
    middle = wgs84.lonlatheight_from_enu(enu[:1], street.frame)[0]
    box = (middle[0] - 1e-4, middle[1] - 1e-4, middle[0] + 1e-4, middle[1] + 1e-4)
    width, height = write_ground_cog(tmp_path / "cut.tif", street, box, "height", {})
    assert 130 < width < 160  # 2e-4 degrees at 49 degrees north: 14.6 m, and a little for the turn of the grid
    assert 210 < height < 230  # 22.2 m


def test_a_map_without_ground_is_refused(tmp_path):
    with pytest.raises(InputError, match="no ground"):
        write_ground_cog(tmp_path / "a.tif", made_source(100), None, "ortho", {})
    assert [*tmp_path.iterdir()] == []
