"""QGIS projects: XML that names layers which GDAL reads, and a colour for each kind that the features have."""

import json
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from service_kit.programs import needed
from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.features import COLLECTIONS
from wayloom.exports.formats import Export, export_map
from wayloom.exports.qgis import ORDER, renderer


@pytest.fixture(scope="module")
def folder(street: DriveOutputs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("project")
    export_map(Export(street, found / "city.qgz"))
    return found


def project_of(folder: Path) -> ElementTree.Element:
    with zipfile.ZipFile(folder / "city.qgz") as archive:
        return ElementTree.fromstring(archive.read("city.qgs"))


def test_every_layer_of_the_project_is_one_that_gdal_reads(folder: Path) -> None:
    needed("ogrinfo", "gdal-bin")
    project = project_of(folder)
    sources = [one.text or "" for one in project.iter("datasource")]
    assert len(sources) >= 3
    for source in sources:
        name, _, layer = source.partition("|layername=")
        done = subprocess.run(["ogrinfo", "-so", name, layer], capture_output=True, text=True, cwd=folder)
        assert "Feature Count: 0" not in done.stdout
        assert "Feature Count" in done.stdout, done.stderr
    listed = [one.get("id") for one in project.iter("layer-tree-layer")]
    assert listed == [one.text for one in project.iter("id")] == [name for name in ORDER if name in listed]
    assert json.loads(project.findtext("projectMetadata/abstract") or "")["format"] == "wayloom-provenance"


def test_the_kinds_that_the_features_have_are_drawn_in_the_colours_of_their_classes(folder: Path, street: DriveOutputs) -> None:
    drawn = {one.get("value"): one.get("symbol") for one in renderer("objects").iter("category")}
    kinds = {one["properties"]["kind"] for key in street.keys for one in street.features("objects", key)}
    assert kinds
    assert kinds <= {*drawn}
    style = ElementTree.fromstring((folder / "city.objects.qml").read_bytes())
    symbols = {one.get("name"): one.find("layer/Option/Option[@name='color']") for one in style.iter("symbol")}
    pole = symbols[drawn["pole"]]
    assert pole is not None
    assert pole.get("value") == ",".join(map(str, [*PALETTE[CLASS_ID["pole"]].tolist(), 255]))


def test_every_collection_has_a_place_in_the_project() -> None:
    assert {*ORDER} == {*COLLECTIONS}
    assert all(renderer(name).tag == "renderer-v2" for name in ORDER)
