"""A real drive from the log to the report: what is done is not done again, what changed is, and nothing is left half-written."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import laspy
import numpy as np
import pytest

from pipeline.real_log import FRAMES, colour_network, damage, first_frames
from segmentation.made_network import THREE
from wayloom.config.stages import drive_stages
from wayloom.dense.points import STANDING
from wayloom.errors import InputError, LogError, ModelError, TooFewKeyframesError
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import finished_key
from wayloom.reports.drive_report import write_report
from wayloom.segmentation.settings import SegmentationSettings

PRODUCTS = {
    "trajectory.tum", "trajectory.kitti", "trajectory.geojson", "cloud.ply", "cloud.laz", "map.png", "overlays", "report.json",
    "report.html", "quality.json", "objects.geojson", "stages",
}  # fmt: skip
BEFORE_GNSS = list(drive_stages()[: drive_stages().index("georeference")])


@pytest.fixture(scope="module")
def log_path(clip_a, tmp_path_factory):
    return first_frames(clip_a, tmp_path_factory.mktemp("log") / "street")


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    return ProcessSettings(segmentation=SegmentationSettings(model=str(colour_network(tmp_path_factory.mktemp("network")))))


@pytest.fixture(scope="module")
def done(log_path, settings, clip_a_gnss, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "drive"
    return out, process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)


def reused(result):
    return [name for name, time in result.times.items() if time.reused]


def stage_digests(out):
    return {name: json.loads((out / "stages" / name / "stage.json").read_text())["digest"] for name in drive_stages()}


def test_everything_promised_is_there(done):
    out, result = done
    assert {path.name for path in out.iterdir()} == PRODUCTS
    assert {path.name for path in (out / "stages").iterdir()} == {*drive_stages(), ".lock", "products.json"}
    assert len((out / "trajectory.tum").read_text().splitlines()) == FRAMES
    assert reused(result) == []
    assert result.odometry.trajectory.tracked.all()


def test_the_report_agrees_with_the_result(done):
    out, result = done
    said = json.loads((out / "report.json").read_text())
    assert said["odometry"]["frames_tracked"] == FRAMES
    assert said["cloud"]["points"] == sum(len(placed.submap) for placed in result.submaps) > 1000
    assert said["georeference"]["origin"] == {"lon_deg": 8.5, "lat_deg": 48.5, "height_m": 0.0}
    assert said["odometry"]["distance_m"] == pytest.approx(32.0, abs=2.5)


def test_a_second_run_does_nothing_twice(done, log_path, settings, clip_a_gnss):
    out, _ = done
    before = {name: (out / "stages" / name / "stage.json").stat().st_mtime_ns for name in drive_stages()}
    again = process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)
    assert reused(again) == list(drive_stages())
    assert before == {name: (out / "stages" / name / "stage.json").stat().st_mtime_ns for name in drive_stages()}


def test_any_number_of_threads_leaves_the_same_bits(done, log_path, settings, clip_a_gnss, tmp_path):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)
    process_drive(log_path, tmp_path / "drive", settings.model_copy(update={"threads": 3}), clip_a_gnss)
    assert stage_digests(tmp_path / "drive") == stage_digests(out)
    for name in PRODUCTS - {"report.json", "report.html", "quality.json", "overlays", "stages"}:
        assert (tmp_path / "drive" / name).read_bytes() == (out / name).read_bytes(), name


def test_another_network_is_run_and_what_follows_from_it(done, log_path, settings, clip_a_gnss, tmp_path):
    out, first = done
    other = colour_network(tmp_path, "others", THREE.replace("13, 8, 10", "0, 8, 10"))
    with_other = settings.model_copy(update={"segmentation": SegmentationSettings(model=str(other))})
    second = process_drive(log_path, out, with_other, clip_a_gnss)
    assert reused(second) == ["ingest", "odometry"]
    assert set(np.unique(second.labels.stereo)) != set(np.unique(first.labels.stereo))


def test_another_origin_moves_the_map_and_nothing_else(done, log_path, settings, clip_a_gnss):
    out, _ = done
    there = settings.model_copy(update={"map_origin": (8.4, 49.0, 110.0)})
    process_drive(log_path, out, settings, clip_a_gnss)
    moved = process_drive(log_path, out, there, clip_a_gnss)
    assert reused(moved) == BEFORE_GNSS
    assert moved.geo.frame.lon_deg == 8.4


def test_other_trust_in_gnss_redoes_the_geo_reference_only(done, log_path, settings, clip_a_gnss):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss)
    careful = settings.model_copy(update={"georeference": GeoReferenceSettings(position_noise_m=0.2)})
    assert reused(process_drive(log_path, out, careful, clip_a_gnss)) == BEFORE_GNSS


@pytest.mark.parametrize("file", ["odometry/odometry.npz", "segmentation/model.json", "labelling/labels.npz", "ingest/log.json"])
def test_a_stage_whose_files_the_disk_lost_is_made_anew(done, log_path, settings, clip_a_gnss, file):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)
    before = (out / "stages" / file).read_bytes(), (out / "cloud.ply").read_bytes()
    (out / "stages" / file).write_bytes(b"")
    again = process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)
    assert [name for name in drive_stages() if name not in reused(again)] == [file.split("/")[0]]
    assert ((out / "stages" / file).read_bytes(), (out / "cloud.ply").read_bytes()) == before


def test_a_touched_file_is_looked_at_again_and_nothing_more(done, log_path, settings, clip_a_gnss):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss)
    os.utime(log_path / "calib.txt")
    assert reused(process_drive(log_path, out, settings, clip_a_gnss)) == [name for name in drive_stages() if name != "ingest"]


def test_dense_points_are_written_where_they_are_asked_for_and_redo_no_stage(done, log_path, settings, clip_a_gnss):
    out, _ = done
    asked = process_drive(log_path, out, settings.model_copy(update={"dense": True}), clip_a_gnss)
    assert reused(asked) == list(drive_stages())
    points = laspy.read(out / "dense.laz")
    assert set(np.unique(points.label).tolist()) <= set(STANDING)
    process_drive(log_path, out, settings, clip_a_gnss, write_more=write_report)
    assert not (out / "dense.laz").exists()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_report_that_fails_leaves_the_products_of_the_run_before(done, log_path, settings, clip_a_gnss, threads):
    out, _ = done

    def fail(result, folder):
        raise OSError(errno.ENOSPC, "No space left on device")

    def kept():
        return {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}

    before = kept()
    with pytest.raises(InputError, match="No space left"):
        process_drive(log_path, out, settings.model_copy(update={"threads": threads}), clip_a_gnss, write_more=fail)
    assert kept() == before


def test_without_gnss_the_map_is_in_its_own_frame(done, log_path, settings, clip_a_gnss):
    out, _ = done
    own = process_drive(log_path, out, settings, None, write_more=write_report)
    assert own.geo.frame is None
    assert reused(own) == [name for name in BEFORE_GNSS if name != "ingest"]
    assert not (out / "trajectory.geojson").exists()
    assert not (out / "markings.geojson").exists()
    assert not (out / "objects.geojson").exists()


def test_two_runs_give_the_same_bytes(done, log_path, settings, clip_a_gnss, tmp_path):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss)
    process_drive(log_path, tmp_path / "again", settings, clip_a_gnss)
    for name in ("trajectory.tum", "cloud.ply", "map.png", "stages/submaps/index.json", "stages/labelling/labels.npz"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name


def test_a_stage_runs_by_itself_from_linked_folders(done, log_path, settings, clip_a_gnss, tmp_path):
    out, _ = done
    process_drive(log_path, out, settings, clip_a_gnss)
    (tmp_path / "inputs").mkdir()
    for name in drive_stages()[:-1]:
        (tmp_path / "inputs" / name).symlink_to(out / "stages" / name)
    (tmp_path / "attempt").mkdir()
    context = StageContext(LogSource(log_path, clip_a_gnss), tmp_path / "inputs", settings)
    metadata = run_stage("submaps", context, tmp_path / "attempt")
    key = stage_key("submaps", context).hex
    assert metadata["key"] == key == finished_key(tmp_path / "attempt") == finished_key(out / "stages" / "submaps")
    assert stage_key("submaps", replace(context, drive_id="other")).hex != key


def test_a_damaged_image_leaves_nothing_behind(settings, clip_a, tmp_path):
    bad = first_frames(clip_a, tmp_path / "bad", 5)
    damage(bad / "image_1" / "000003.png")
    with pytest.raises(LogError, match=r"000003\.png"):
        process_drive(bad, tmp_path / "a" / "out", settings)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad"]


def test_a_log_that_cannot_be_tracked_leaves_nothing_behind(settings, clip_a, tmp_path):
    exchanged = first_frames(clip_a, tmp_path / "exchanged", 3)
    (exchanged / "image_0").rename(exchanged / "aside")
    (exchanged / "image_1").rename(exchanged / "image_0")
    (exchanged / "aside").rename(exchanged / "image_1")
    with pytest.raises(LogError, match="left and right images are exchanged"):
        process_drive(exchanged, tmp_path / "out", settings)
    tiny = first_frames(clip_a, tmp_path / "tiny", 3)
    for file in tiny.glob("image_?/*.png"):
        cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), (1241, 60)))
    calibration = (tiny / "calib.txt").read_text().replace("1.852157000000e+02", "3.0e+01")
    (tiny / "calib.txt").write_text(calibration)
    with pytest.raises(InputError, match="too small"):
        process_drive(tiny, tmp_path / "out", settings)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["exchanged", "tiny"]


def test_nothing_is_written_into_the_log(settings, clip_a, tmp_path):
    log = first_frames(clip_a, tmp_path / "log", 3)
    for out in (log, log / "out", log / "image_0"):
        with pytest.raises(InputError, match="lies inside the log"):
            process_drive(log, out, settings)
    assert sorted(path.name for path in log.iterdir()) == ["calib.txt", "image_0", "image_1", "times.txt"]


def test_a_missing_network_is_told_before_the_work(log_path, tmp_path):
    with pytest.raises(ModelError, match="unknown network"):
        process_drive(log_path, tmp_path / "out", ProcessSettings(segmentation=SegmentationSettings(model="no-such-network")))
    assert not list(tmp_path.iterdir())


def test_a_missing_geoid_grid_is_told_before_the_work(log_path, settings, tmp_path):
    with pytest.raises(InputError, match="no such geoid grid"):
        process_drive(log_path, tmp_path / "out", settings.model_copy(update={"geoid": tmp_path / "none.gtx"}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("spoil", [lambda data: data[: len(data) // 2], lambda data: b"hello", lambda data: b""])
def test_a_damaged_network_is_told_before_the_work(log_path, tmp_path, spoil):
    network = colour_network(tmp_path / "network").with_suffix(".onnx")
    network.write_bytes(spoil(network.read_bytes()))
    with pytest.raises(ModelError, match="not an ONNX file"):
        process_drive(log_path, tmp_path / "out", ProcessSettings(segmentation=SegmentationSettings(model=str(network))))
    assert not (tmp_path / "out").exists()


def test_an_out_folder_that_is_a_file_is_named(log_path, settings, tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="out"):
        process_drive(log_path, tmp_path / "out", settings)
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_where_nothing_can_be_written_is_named(log_path, settings):
    with pytest.raises(InputError, match="/proc/wayloom"):
        process_drive(log_path, Path("/proc/wayloom"), settings)


def test_a_blank_stretch_is_bridged_and_warned_of(settings, clip_a, tmp_path):
    blinded = first_frames(clip_a, tmp_path / "blinded", 30)
    for i in range(12, 16):
        for side in ("image_0", "image_1"):
            cv2.imwrite(str(blinded / side / f"{i:06d}.png"), np.zeros((376, 1241), np.uint8))
    result = process_drive(blinded, tmp_path / "out", settings, write_more=write_report)
    assert not result.odometry.trajectory.tracked[12:16].any()
    said = json.loads((tmp_path / "out" / "report.json").read_text())
    assert said["warnings"][0].startswith("4 of 30 frames were lost (first frame 12: the image is blank)")
    assert len((tmp_path / "out" / "trajectory.kitti").read_text().splitlines()) == 30


def test_a_drive_of_one_frame_ends_with_a_reason(settings, clip_a, tmp_path):
    with pytest.raises(TooFewKeyframesError, match="at least 2 keyframes"):
        process_drive(first_frames(clip_a, tmp_path / "one", 1), tmp_path / "out", settings)
    assert (tmp_path / "out" / "stages" / "odometry" / "report.json").exists()
