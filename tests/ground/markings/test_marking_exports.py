import json
from pathlib import Path

import numpy as np
import pytest
from drawn_ground import asphalt, bar, paint

from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.ground.files import save_sheets
from wayloom.ground.markings.exports import export_markings, geojson, markings_of_drive
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.sheet import GroundSheet
from wayloom.submaps.submap import PlacedSubmap, Submap

FRAME = MapFrame(8.4, 49.0, 110.0)
SIGMA_M, SIGMA_YAW_RAD = 0.04, 0.001
COVARIANCE = np.diag([SIGMA_M**2] * 3 + [0.0, 0.0, SIGMA_YAW_RAD**2])


def submap() -> Submap:
    fields = {
        "xyz": np.zeros((0, 3), np.float32), "label": np.zeros(0, np.uint8), "variance": np.zeros(0, np.float32),
        "grey": np.zeros(0, np.uint8), "seen_ns": np.zeros(0, np.int64), "keyframe": np.zeros(0, np.uint32),
        "vote_start": np.zeros(1, np.uint32), "vote_class": np.zeros(0, np.uint8), "vote_weight": np.zeros(0, np.float32),
        "keyframe_frame": np.zeros(1, np.uint32), "keyframe_t_ns": np.zeros(1, np.int64), "T_submap_cam": np.eye(4)[None],
    }  # fmt: skip
    return Submap(**fields, length_m=30.0, points_left_out={})


def placed(frame: MapFrame | None) -> PlacedSubmap:
    T = np.eye(4)
    T[:3, 3] = 100.0, 50.0, 2.0
    return PlacedSubmap(submap(), T, COVARIANCE, "drive", frame)


def sheet(corner_x: int) -> GroundSheet:
    """Twelve metres of road, 30 m long, with a kerb in the north and dashes every 3 m that start at a sheet's x of 0."""
    fine = asphalt()
    for x in np.arange(-30.0, 60.0, 3.0):
        paint(fine, bar(x - corner_x * 0.1 + 0.75, 4.0, 1.5, 0.15))
    grey = fine.reshape(240, 4, 600, 4).mean(axis=(1, 3))
    high = (np.arange(120) > 90)[:, None] + np.zeros((120, 300), bool)
    votes = np.stack([np.where(high, 0, 90), np.where(high, 90, 0), np.zeros(high.shape)], axis=-1).astype(np.uint16)
    height = np.where(high, 120, 0) + np.random.default_rng(0).normal(0, 4, high.shape)
    return GroundSheet(
        submap().digest, np.eye(4), np.array([corner_x, 0], np.int32), np.zeros(2, np.int64), np.rint(height).astype(np.int16),
        np.full(high.shape, 5, np.uint8), votes, np.clip(grey, 0, 255).astype(np.uint8)[..., None],
        np.full(grey.shape, 30, np.uint8),
    )  # fmt: skip


def test_a_drives_markings_lie_where_its_submap_does(tmp_path: Path) -> None:
    save_sheets([sheet(0)], tmp_path)
    found, kerbs = markings_of_drive(tmp_path, [placed(FRAME)], MarkingSettings(), KerbSettings())
    assert {one.kind for one in found} == {"dash"}
    assert len(found) == 10
    for one in found:
        np.testing.assert_allclose(one.line[:, 1], 54.0, atol=0.02)
        np.testing.assert_allclose(one.line[:, 2], 2.0, atol=0.02)
    (kerb,) = kerbs
    assert np.abs(kerb.line[:, 1] - 59.1).max() < 0.08


def test_the_file_says_the_same_in_degrees(tmp_path: Path) -> None:
    save_sheets([sheet(0)], tmp_path / "sheets")
    file = tmp_path / "markings.geojson"
    export_markings(tmp_path / "sheets", [placed(FRAME)], file, MarkingSettings(), KerbSettings())
    content = json.loads(file.read_text())
    kinds = [feature["properties"]["kind"] for feature in content["features"]]
    assert kinds.count("dash") == 10
    assert kinds.count("kerb") == 1
    for feature in content["features"]:
        enu = enu_from_lonlatheight(np.array(feature["geometry"]["coordinates"]), FRAME)
        told = feature["properties"]
        assert told["sigma_place_m"] == pytest.approx(np.hypot(SIGMA_M, SIGMA_YAW_RAD * np.hypot(100, 50)), abs=6e-4)
        if told["kind"] == "dash":
            np.testing.assert_allclose(enu[:, 1], 54.0, atol=0.03)
            assert 0.1 < told["width_m"] < 0.2
            assert told["covariance_m2"][2] == pytest.approx(told["sigma_m"] ** 2, rel=0.2)
        else:
            assert told["height_m"] == pytest.approx(0.12, abs=0.015)


def test_a_drive_without_a_place_on_earth_has_no_file(tmp_path: Path) -> None:
    save_sheets([sheet(0)], tmp_path / "sheets")
    export_markings(tmp_path / "sheets", [placed(None)], tmp_path / "markings.geojson", MarkingSettings(), KerbSettings())
    assert not (tmp_path / "markings.geojson").exists()


def test_an_empty_collection_is_valid() -> None:
    assert geojson([], [], FRAME) == {"type": "FeatureCollection", "features": []}
