"""Export formats: which one a name asks for, and what each refuses."""

import json
import re

import laspy
import pytest

from exports.made_sources import made_source
from geodesy.made_geoid import write_gtx
from wayloom.errors import InputError, UnknownFormatError
from wayloom.exports.formats import EXPORT_FORMATS, Export, checked_format, export_map, format_of
from wayloom.geodesy.geoid import GeoidGrid

LACKS = {"cog": "no ground", "mcap": "poses in time", "rrd": "poses in time"}
"""What the made map has not, of which these formats are."""


@pytest.fixture(scope="module")
def city():
    return made_source(400, extent_m=40.0)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("map.laz", "laz"), ("map.copc.laz", "copc"), ("a.b.ply", "ply"), ("map.tif", "cog"), ("map", "tiles"), ("m.json", "geojson")],
)
def test_a_files_name_asks_for_a_format_by_its_longest_ending(tmp_path, name, expected):
    assert format_of(tmp_path / name, None) is EXPORT_FORMATS[expected]
    assert format_of(tmp_path / name, "gpkg") is EXPORT_FORMATS["gpkg"]


@pytest.mark.parametrize(("name", "form"), [("map.docx", None), ("map.laz", "las2")])
def test_an_unknown_format_lists_the_known_ones(tmp_path, name, form):
    with pytest.raises(UnknownFormatError, match=", ".join(EXPORT_FORMATS)):
        checked_format(tmp_path / name, form)


def test_what_a_format_cannot_hold_is_refused_before_anything_is_read(tmp_path):
    with pytest.raises(InputError, match="known are points"):
        checked_format(tmp_path / "map.laz", None, ("kerbs",))
    with pytest.raises(InputError, match="leave --geoid away"):
        checked_format(tmp_path / "map.ply", None, (), True)
    with pytest.raises(InputError, match="one by one"):
        export_map(Export(made_source(10), tmp_path / "map.pmtiles", layers=("vector", "ortho")))


@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_every_format_writes_a_map_or_says_what_it_lacks_and_leaves_nothing(city, tmp_path, name):
    job = Export(city, tmp_path / "out")
    if lack := LACKS.get(name):
        with pytest.raises(InputError, match=lack):
            export_map(job, name)
        assert [*tmp_path.iterdir()] == []
    else:
        assert export_map(job, name)
        beside = r"out\.gpkg|out\.\w+\.qml" if name == "qgis" else r"out\.json"
        assert [path.name for path in tmp_path.iterdir() if not re.fullmatch(f"out|{beside}", path.name)] == []


@pytest.mark.parametrize("name", ["laz", "copc", "ply", "png", "3dtiles", "geojson"])
def test_an_empty_box_gives_an_empty_file_or_says_so(city, tmp_path, name):
    job = Export(city, tmp_path / "out", (0.0, 0.0, 1.0, 1.0))
    if name in ("png", "3dtiles"):
        with pytest.raises(InputError, match="nothing in the box"):
            export_map(job, name)
        assert [*tmp_path.iterdir()] == []
    else:
        assert export_map(job, name).startswith("0 ")


def test_the_provenance_tells_the_box(city, tmp_path):
    export_map(Export(city, tmp_path / "a.geojson", (8.0, 48.0, 9.0, 49.0)))
    assert json.loads((tmp_path / "a.geojson").read_text())["provenance"]["bbox"] == [8.0, 48.0, 9.0, 49.0]


def test_provenance_of_thousands_of_drives_lies_beside_a_laz(city, tmp_path):
    class ManyDrives(type(city)):
        def provenance(self):
            return {"drives": [{"id": f"{number:064x}"} for number in range(2000)]}

    many = ManyDrives(city.whole)
    export_map(Export(many, tmp_path / "a.laz"))
    assert len(json.loads((tmp_path / "a.laz.json").read_text())["drives"]) == 2000
    (record,) = [one for one in laspy.read(tmp_path / "a.laz").header.vlrs if one.user_id == "wayloom"]
    assert json.loads(record.record_data_bytes())["drives"].startswith("2000")


def test_progress_grows_to_one(city, tmp_path):
    shares = []
    export_map(Export(city, tmp_path / "a.laz", progress=lambda share, what: shares.append(share)))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) == len(city.keys)


def test_a_geoid_that_does_not_reach_leaves_nothing(city, tmp_path):
    grid = GeoidGrid(write_gtx(tmp_path / "grid.gtx"))
    far = made_source(200, lon=40.0, lat=30.0)
    with pytest.raises(InputError):
        export_map(Export(far, tmp_path / "a.laz", geoid=grid))
    assert [path.name for path in tmp_path.iterdir()] == ["grid.gtx"]
