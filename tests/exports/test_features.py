"""Features that are exported, opened by GDAL, pyogrio and pyarrow."""

import errno
import json
import shutil
import sqlite3
import subprocess

import numpy as np
import pyarrow.parquet
import pyogrio
import pytest
import shapely

from exports.made_sources import POLES, made_source
from service_kit.programs import needed
from wayloom.errors import InputError
from wayloom.exports import geopackage
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.features import COLLECTIONS, read_collection, single_parts
from wayloom.exports.geojson import write_geojson
from wayloom.exports.geopackage import write_geopackage
from wayloom.exports.geoparquet import write_feature_parquet, write_point_parquet
from wayloom.exports.points import map_batches
from wayloom.exports.wkb import wkb
from wayloom.geodesy import wgs84

KINDS = ("areas", "objects", "markings", "kerbs", "tracks")


@pytest.fixture(scope="module")
def truth(street):
    """The features of each collection."""
    return {name: [*read_collection(name, street, None)] for name in KINDS}


@pytest.fixture(scope="module")
def files(street, tmp_path_factory):
    folder, provenance = tmp_path_factory.mktemp("features"), street.provenance()
    for write, name in ((write_geojson, "a.geojson"), (write_geopackage, "a.gpkg"), (write_feature_parquet, "a.parquet")):
        write(folder / name, street, None, (), provenance)
    return folder


def ogrinfo(*arguments):
    needed("ogrinfo", "gdal-bin")
    done = subprocess.run(["ogrinfo", *map(str, arguments)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def shapes(features):
    return [shapely.from_wkb(wkb(feature["geometry"])) for feature in features]


def test_the_made_street_has_every_kind_of_feature(truth):
    assert sum(one["properties"]["kind"] == "dash" for one in truth["markings"]) == 12  # from 0 to 72 m, one every 6 m
    assert len(truth["kerbs"]) >= 2
    assert len(truth["tracks"]) == 2
    assert len(truth["objects"]) == len(POLES)
    assert {"road", "sidewalk"} == {one["properties"]["kind"] for one in truth["areas"]}


def test_objects_that_two_drives_saw_are_one_each_where_they_stand(street, truth):
    places = np.array([one["geometry"]["coordinates"] for one in truth["objects"]])
    found = wgs84.enu_from_lonlatheight(places, street.frame)
    away = np.linalg.norm(found[:, None] - POLES[None], axis=2).min(axis=0)
    assert away.max() < 0.002  # heights are told in millimetres
    assert all(len(one["properties"]["drives"]) == 2 for one in truth["objects"])


def test_the_features_do_not_depend_on_the_order_of_the_folders(street_folders, truth):
    back = DriveOutputs(street_folders[::-1])
    assert {name: [*read_collection(name, back, None)] for name in KINDS} == truth


@pytest.mark.parametrize(
    "geometry",
    [
        {"type": "Point", "coordinates": [8.0, 49.0, 100.0]},
        {"type": "LineString", "coordinates": [[8.0, 49.0, 100.0], [8.1, 49.1, 101.0]]},
        {"type": "Polygon", "coordinates": [[[0, 0, 1], [4, 0, 1], [4, 4, 1], [0, 0, 1]],
                                            [[1, 0.5, 1], [2, 0.5, 1], [2, 1, 1], [1, 0.5, 1]]]},
        {"type": "MultiLineString", "coordinates": [[[179, 1, 0], [180, 1, 0]], [[-180, 1, 0], [-179, 1, 0]]]},
        {"type": "MultiPolygon", "coordinates": [[[[0, 0, 1], [4, 0, 1], [4, 4, 1], [0, 0, 1]]]]},
    ],
)  # fmt: skip
def test_well_known_binary_is_what_shapely_reads(geometry):
    found = shapely.from_wkb(wkb(geometry))
    assert found.geom_type == geometry["type"]
    assert found.has_z
    assert shapely.geometry.mapping(found) == shapely.geometry.mapping(shapely.geometry.shape(geometry))


def test_parts_of_many_become_features_of_their_own():
    line = {"type": "MultiLineString", "coordinates": [[[179, 1], [180, 1]], [[-180, 1], [-179, 1]]]}
    found = [*single_parts([{"type": "Feature", "geometry": line, "properties": {"a": 1}}])]
    assert [one["geometry"]["type"] for one in found] == ["LineString", "LineString"]
    assert all(one["properties"] == {"a": 1} for one in found)


def test_a_geojson_holds_every_feature_and_the_provenance(files, street, truth):
    content = json.loads((files / "a.geojson").read_text())
    assert content["provenance"] == street.provenance()
    found = {name: [one for one in content["features"] if one["properties"]["collection"] == name] for name in KINDS}
    for name in KINDS:
        assert [one["geometry"] for one in found[name]] == [one["geometry"] for one in truth[name]]


@pytest.mark.parametrize("name", KINDS)
def test_ogrinfo_and_pyogrio_read_each_table_of_a_geopackage_whole(files, truth, name):
    text = ogrinfo("-so", files / "a.gpkg", name)
    assert f"Feature Count: {len(truth[name])}" in text
    assert 'ID["EPSG",4326]' in text
    meta, _, geometry, columns = pyogrio.raw.read(files / "a.gpkg", layer=name)
    assert [*meta["fields"]] == [*COLLECTIONS[name].columns]
    assert shapely.from_wkb(geometry).tolist() == shapes(truth[name])
    told = dict(zip(meta["fields"], columns, strict=True))
    assert told["kind"].tolist() == [one["properties"]["kind"] for one in truth[name]]


def test_a_geopackage_is_one_by_its_own_tables(files, street, truth):
    with sqlite3.connect(files / "a.gpkg") as db:
        assert db.execute("PRAGMA application_id").fetchone()[0] == 0x47504B47
        assert db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        assert db.execute("PRAGMA foreign_key_check").fetchall() == []
        (metadata,) = db.execute("SELECT metadata FROM gpkg_metadata").fetchone()
        rows = db.execute("SELECT table_name, min_x, max_y FROM gpkg_contents ORDER BY 1").fetchall()
        in_tree = db.execute("SELECT count(*) FROM rtree_kerbs_geom").fetchone()[0]
    db.close()
    assert json.loads(metadata) == street.provenance()
    assert [row[0] for row in rows] == sorted(KINDS)
    assert in_tree == len(truth["kerbs"])
    bounds = shapely.unary_union(shapes(truth["kerbs"])).bounds
    assert {name: box for name, *box in rows}["kerbs"] == [bounds[0], bounds[3]]


def test_gdal_finds_features_by_the_r_tree_and_keeps_it_when_it_edits(files, truth, tmp_path):
    needed("ogrinfo", "gdal-bin")
    west, south, _, _ = shapes(truth["markings"])[0].bounds
    box = (west - 1e-7, south - 1e-7, west + 1e-7, south + 1e-7)
    found = pyogrio.raw.read(files / "a.gpkg", layer="markings", bbox=box)[2]
    expected = [one for one in shapes(truth["markings"]) if shapely.intersects(one, shapely.box(*box))]
    assert 1 <= len(found) <= 2
    assert len(found) >= len(expected)
    copy = tmp_path / "edited.gpkg"
    shutil.copy(files / "a.gpkg", copy)
    subprocess.run(["ogrinfo", "-q", "-sql", "DELETE FROM kerbs WHERE fid = 1", str(copy)], check=True, capture_output=True)
    with sqlite3.connect(copy) as db:
        assert db.execute("SELECT count(*) FROM rtree_kerbs_geom").fetchone()[0] == len(truth["kerbs"]) - 1
    db.close()


def test_a_geoparquet_has_the_standards_metadata_and_every_feature(files, street, truth):
    file = pyarrow.parquet.ParquetFile(files / "a.parquet")
    metadata = file.metadata.metadata
    geo = json.loads(metadata[b"geo"])
    assert json.loads(metadata[b"wayloom"]) == street.provenance()
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    column = geo["columns"]["geometry"]
    assert column["encoding"] == "WKB"
    assert set(column["geometry_types"]) == {f"{one['geometry']['type']} Z" for name in KINDS for one in truth[name]}
    table = file.read().to_pydict()
    everything = [one for name in KINDS for one in truth[name]]
    assert [shapely.from_wkb(data) for data in table["geometry"]] == shapes(everything)
    assert table["collection"] == [name for name in KINDS for _ in truth[name]]
    boxes = np.array([[row[side] for side in ("xmin", "ymin", "xmax", "ymax")] for row in table["bbox"]])
    assert np.array_equal(boxes, np.array([one.bounds for one in shapes(everything)]))
    assert column["bbox"] == [*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)]
    assert all(column["covering"]["bbox"][side] == ["bbox", side] for side in ("xmin", "ymin", "xmax", "ymax"))


def test_points_in_a_geoparquet_are_the_maps_voxels(tmp_path):
    city = made_source(2000)
    assert write_point_parquet(tmp_path / "p.parquet", map_batches(city, None), city.frame, {}) == len(city.whole)
    table = pyarrow.parquet.read_table(tmp_path / "p.parquet")
    whole = [city.voxels(key) for key in city.keys]
    truth = wgs84.lonlatheight_from_enu(np.concatenate([one.points_enu for one in whole]), city.frame)
    places = shapely.get_coordinates(shapely.from_wkb(table["geometry"].to_numpy()), include_z=True)
    assert np.array_equal(places, truth)
    assert np.array_equal(table["label"].to_numpy(), np.concatenate([one.label for one in whole]))
    assert np.array_equal(table["last_seen"].cast("int64").to_numpy(), np.concatenate([one.last_seen_ns for one in whole]))
    assert table["class"].to_pylist()[0] in {"road", "sidewalk", "building", "wall", "fence", "pole", "vegetation", "terrain",
                                             "traffic light", "traffic sign"}  # fmt: skip


@pytest.mark.parametrize("write", [write_geojson, write_geopackage, write_feature_parquet])
def test_progress_tells_of_each_collection_of_regions_once_and_by_its_name(street, tmp_path, write):
    told = []
    write(tmp_path / "a", street, None, (), {}, lambda share, what: told.append(what) if share == 1.0 else None)
    count = len(street.keys)
    assert told == [f"{name}, region {count} of {count}" for name in ("areas", "objects", "markings", "kerbs")]


def test_an_unknown_collection_lists_the_known_ones(street, tmp_path):
    with pytest.raises(InputError, match="areas, objects, markings, kerbs"):
        write_geojson(tmp_path / "a.geojson", street, None, ("streets",), {})


def test_a_box_keeps_whole_features_that_touch_it_and_no_other(street, truth, tmp_path):
    middle = shapes(truth["markings"])[3].centroid
    box = (middle.x - 1e-6, middle.y - 1e-6, middle.x + 1e-6, middle.y + 1e-6)
    write_geojson(tmp_path / "a.geojson", street, box, ("markings",), {})
    kept = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert truth["markings"][3]["geometry"] in [one["geometry"] for one in kept]
    assert all(shapely.box(*shapely.geometry.shape(one["geometry"]).bounds).intersects(shapely.box(*box)) for one in kept)


def test_a_full_disk_leaves_no_half_geopackage(street, tmp_path, monkeypatch):
    """SQLite is told that there is room for three pages."""

    def connect(*arguments, **more):
        db = sqlite3.connect(*arguments, **more)
        db.execute("PRAGMA max_page_count = 3")
        return db

    monkeypatch.setattr(geopackage, "connect", connect)
    with pytest.raises(OSError, match=r"full.*a\.gpkg") as problem:
        write_geopackage(tmp_path / "a.gpkg", street, None, (), {})
    assert problem.value.errno == errno.ENOSPC
    assert [*tmp_path.iterdir()] == []
