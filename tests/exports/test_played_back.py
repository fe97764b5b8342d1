"""Results as recordings for Foxglove and Rerun, read back by the formats' own readers and by ours."""

import base64
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from exports.made_sources import drives_with_ground, made_source
from georeference.made_gnss_drives import odometry_of
from wayloom.config.classes import PALETTE
from wayloom.errors import InputError
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.formats import Export, export_map
from wayloom.exports.foxglove import SCHEMAS
from wayloom.exports.recorded_drives import recorded_drives
from wayloom.geodesy import wgs84
from wayloom.georeference.files import GEOREFERENCE_FILE, save_georeference
from wayloom.georeference.types import GeoReference
from wayloom.logs.ros2.foxglove import translator
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, save_odometry

FRAMES = 6


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> DriveOutputs:
    """Two drives with poses; the second has label images."""
    folders = drives_with_ground(tmp_path_factory.mktemp("street"))
    source = DriveOutputs(folders)
    for number, folder in enumerate(folders):
        stages = folder / "stages"
        T = np.tile(np.eye(4), (FRAMES, 1, 1))
        T[:, :3, 3] = source.place + np.array([0.0, 10.0 * number, 0.0]) + np.arange(FRAMES)[:, None]
        (stages / "odometry").mkdir(parents=True)
        t_ns = 10**18 + np.arange(FRAMES) * 100_000_000
        save_odometry(odometry_of(t_ns, T), stages / "odometry" / ODOMETRY_FILE)
        covariance = np.broadcast_to(np.diag([0.01, 0.01, 0.04, 0, 0, 0]), (FRAMES, 6, 6))
        (stages / "georeference").mkdir(parents=True)
        save_georeference(GeoReference(source.frame, T, covariance), stages / "georeference" / GEOREFERENCE_FILE)
    labels = folders[1] / "stages" / "segmentation" / "left"
    labels.mkdir(parents=True)
    cv2.imwrite(str(labels / "0000000002.png"), np.full((4, 6), 8, np.uint8))
    return source


def messages(file: Path) -> dict[str, list[tuple[int, dict]]]:
    found: dict[str, list[tuple[int, dict]]] = {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            content = json.loads(message.data)
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert {*content} == {*json.loads(schema.data)["properties"]}
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def test_a_foxglove_recording_has_poses_places_points_and_labels_of_each_drive(drives: DriveOutputs, tmp_path: Path) -> None:
    export_map(Export(drives, tmp_path / "results.mcap"))
    found = messages(tmp_path / "results.mcap")
    first, second = recorded_drives(drives, tmp_path)
    kinds = {f"/{one.name}/{kind}" for one in (first, second) for kind in ("pose", "location")}
    assert {*found} == {*kinds, "/tf", "/map/points", f"/{second.name}/left/labels"}
    assert len(found["/tf"]) == 2 * FRAMES
    for row, (t_ns, content) in enumerate(found[f"/{first.name}/pose"]):
        assert t_ns == first.t_ns[row] == content["timestamp"]["sec"] * 10**9 + content["timestamp"]["nsec"]
        assert [content["pose"]["position"][axis] for axis in "xyz"] == pytest.approx(first.T_map_cam[row, :3, 3])
    ((t_ns, image),) = found[f"/{second.name}/left/labels"]
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert (t_ns, picture[0, 0, ::-1].tolist()) == (second.t_ns[2], PALETTE[8].tolist())


def test_the_points_of_a_recording_are_the_voxels_of_the_map(drives: DriveOutputs, tmp_path: Path) -> None:
    export_map(Export(drives, tmp_path / "results.mcap"))
    ((_, cloud),) = messages(tmp_path / "results.mcap")["/map/points"]
    types = {1: "u1", 7: "<f4"}
    dtype = np.dtype(
        {"names": [one["name"] for one in cloud["fields"]], "formats": [types[one["type"]] for one in cloud["fields"]],
         "offsets": [one["offset"] for one in cloud["fields"]], "itemsize": cloud["point_stride"]}
    )  # fmt: skip
    rows = np.frombuffer(base64.b64decode(cloud["data"]), dtype)
    voxels = [found for key in drives.keys if (found := drives.voxels(key)) is not None]
    assert len(rows) == sum(map(len, voxels)) > 100
    assert np.array_equal(np.bincount(rows["label"]), np.bincount(np.concatenate([one.label for one in voxels])))
    assert np.array_equal(np.column_stack([rows[name] for name in ("red", "green", "blue")]), PALETTE[rows["label"]])


def test_places_on_earth_are_read_by_our_own_reader_of_foxglove(drives: DriveOutputs, tmp_path: Path) -> None:
    export_map(Export(drives, tmp_path / "results.mcap"))
    (first, *_) = recorded_drives(drives, tmp_path)
    assert drives.frame is not None
    assert first.lon_lat_height is not None
    _, content = messages(tmp_path / "results.mcap")[f"/{first.name}/location"][3]
    read = translator("foxglove.LocationFix", "json", b"")
    assert read is not None
    assert read.stamp(json.dumps(content).encode()) == first.t_ns[3]
    assert [content[name] for name in ("longitude", "latitude", "altitude")] == pytest.approx(first.lon_lat_height[3])
    assert np.diag(np.array(content["position_covariance"]).reshape(3, 3)) == pytest.approx([0.01, 0.01, 0.04], rel=0.01)
    assert {*content} == {*SCHEMAS["LocationFix"]["properties"]}
    there = wgs84.enu_from_lonlatheight(first.lon_lat_height, drives.frame)
    assert np.linalg.norm(there - drives.place, axis=1).max() < 100.0


def test_a_map_without_poses_in_time_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="folders of drives"):
        export_map(Export(made_source(100), tmp_path / "results.mcap"))
    assert [*tmp_path.iterdir()] == []


def test_a_rerun_recording_is_sound_by_reruns_own_reader(drives: DriveOutputs, tmp_path: Path) -> None:
    out = tmp_path / "results.rrd"
    export_map(Export(drives, out))
    home = {**os.environ, "HOME": str(tmp_path / "home"), "XDG_CONFIG_HOME": str(tmp_path / "home")}
    for command in (("analytics", "disable"), ("rrd", "print", str(out))):
        done = subprocess.run([sys.executable, "-m", "rerun", *command], capture_output=True, text=True, timeout=120, env=home)
    assert done.returncode == 0, done.stderr
    (first, second) = recorded_drives(drives, tmp_path)
    for entity in ("/map/points", f"/map/{first.name}/left_camera", f"/map/{second.name}/labels", "/provenance"):
        assert entity in done.stdout
    assert {one.name for one in tmp_path.iterdir()} <= {"results.rrd", "home"}
