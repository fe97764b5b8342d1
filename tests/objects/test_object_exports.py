"""Objects as GeoJSON, out of a folder of sightings."""

import json
from pathlib import Path

import numpy as np
import pytest

from made_ground import MadeStreet
from objects.made_sightings import some_sightings
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.objects.exports import export_objects, objects_of_drive
from wayloom.objects.files import save_all
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import SIGN

FRAME = MapFrame(8.4, 49.0, 110.0)


def test_a_drives_objects_are_told_in_degrees_with_their_sigmas(tmp_path: Path) -> None:
    (submap,) = MadeStreet(count=3).submaps(1)
    sightings = some_sightings([[0.0, 0.0, 10.0]], kind=SIGN, facing=[0.0, 0.0, -1.0], name=submap.submap.digest)
    save_all([sightings], tmp_path)
    objects = objects_of_drive(tmp_path, [submap], ObjectFusionSettings())
    export_objects(objects, FRAME, tmp_path / "objects.geojson")
    (one,) = json.loads((tmp_path / "objects.geojson").read_text())["features"]
    place = wgs84.enu_from_lonlatheight(np.array([one["geometry"]["coordinates"]]), FRAME)[0]
    np.testing.assert_allclose(place, objects[0].position, atol=0.002)
    told = one["properties"]
    assert (told["kind"], told["drives"], told["looks"]) == ("traffic_sign", ["drive"], 5)
    assert told["sigma_m"] == pytest.approx(0.03, abs=0.001)
    assert told["facing_deg"] == pytest.approx(180.0, abs=0.2)
    assert one["id"] == objects[0].id


def test_a_submap_without_sightings_is_passed_over(tmp_path: Path) -> None:
    save_all([], tmp_path)
    assert objects_of_drive(tmp_path, MadeStreet(count=3).submaps(1), ObjectFusionSettings()) == []
