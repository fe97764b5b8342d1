"""A stage's key changes with all that its result depends on, and with nothing else."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from logs.made_drives import FRAMES, T_CAM_IMU, WRITERS, made_frames, made_imu, made_packets, sample_files, write_drive
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.labelling.settings import LabellingSettings
from wayloom.logs.registry import open_log
from wayloom.odometry.settings import OdometrySettings
from wayloom.pipeline import digests, running
from wayloom.pipeline.code_version import CodeVersion
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.log_parts import LOG_PARTS, images_digest, read_log_file
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import StageKey, run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import STAGE_FILE, digest_of_folder, read_stage_file
from wayloom.pipeline.stage_report import REPORT_FILE

CODE = CodeVersion("v", (), {"numpy": "2"})
KEY = StageKey("odometry", {"a": "1"}, {"p": 1}, CODE)


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "0.png").write_bytes(b"labels")
    (tmp_path / "model.json").write_text("{}")
    return tmp_path


def test_the_digest_of_a_folder_depends_on_names_and_bytes(stage):
    before = digest_of_folder(stage)
    (stage / "left" / "0.png").rename(stage / "left" / "1.png")
    renamed = digest_of_folder(stage)
    (stage / "left" / "1.png").write_bytes(b"other labels")
    assert len({before, renamed, digest_of_folder(stage)}) == 3


def test_reports_and_times_of_change_do_not_count(stage):
    before = digest_of_folder(stage)
    (stage / REPORT_FILE).write_text('{"seconds": 3.2}')
    (stage / STAGE_FILE).write_text("{}")
    (stage / "model.json").write_text("{}")
    assert digest_of_folder(stage) == before


@pytest.mark.parametrize(
    "changed",
    [
        replace(KEY, stage="labelling"),
        replace(KEY, inputs={"a": "2"}),
        replace(KEY, parameters={"p": 2}),
        replace(KEY, code=replace(CODE, digest="w")),
        replace(KEY, code=replace(CODE, libraries={"numpy": "3"})),
    ],
)
def test_a_key_depends_on_stage_inputs_parameters_code_and_libraries(changed):
    assert replace(KEY).hex == KEY.hex
    assert changed.hex != KEY.hex


def test_the_order_of_parameters_does_not_matter():
    assert sha256_of_json({"a": 1, "b": 2}) == sha256_of_json({"b": 2, "a": 1})


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"key": "x"}'])
def test_a_stage_without_a_whole_stage_file_is_not_finished(tmp_path, content):
    if content is not None:
        (tmp_path / STAGE_FILE).write_text(content)
    assert read_stage_file(tmp_path) is None


def test_a_finished_stage_says_what_it_is(tmp_path):
    metadata = {"key": "k", "digest": "d", "seconds": 1.0}
    (tmp_path / STAGE_FILE).write_text(json.dumps(metadata))
    assert read_stage_file(tmp_path) == metadata


def keys_of(log_path: Path, folder: Path, gnss: Path | None = None) -> dict[str, str]:
    """The keys of ingest and of stages that read the log, after ingest; what they read of other stages is always the same."""
    context = StageContext(LogSource(log_path, gnss), folder, ProcessSettings())
    (folder / "ingest").mkdir(parents=True)
    for name in ("odometry", "labelling", "loops"):
        (folder / name).mkdir()
        (folder / name / STAGE_FILE).write_text('{"key": "k", "digest": "d", "seconds": 1.0}')
    run_stage("ingest", context, folder / "ingest")
    return {name: stage_key(name, context).hex for name in ("ingest", "odometry", "segmentation", "georeference")}


@pytest.mark.parametrize("log_format", ["kitti-raw", "euroc", "mcap"])
def test_digests_of_what_ingest_has_read_are_those_of_the_files(tmp_path: Path, log_format: str, monkeypatch: pytest.MonkeyPatch):
    log_path, read = write_drive(tmp_path / "drive", log_format), list[Path]()
    whole = digests.sha256_of_file
    monkeypatch.setattr(digests, "sha256_of_file", lambda file: (read.append(file), whole(file))[1])
    (tmp_path / "ingest").mkdir()
    context = StageContext(LogSource(log_path, None), tmp_path, ProcessSettings())
    run_stage("ingest", context, tmp_path / "ingest")
    images = {*context.log.pairs.left, *context.log.pairs.right} if log_format != "mcap" else set[Path]()
    assert not images.intersection(read)
    content = read_log_file(tmp_path / "ingest")
    assert content["digests"]["images"] == images_digest(context.log, context.reader_version)


def changed(before: dict[str, str], after: dict[str, str]) -> set[str]:
    return {name for name in before if before[name] != after[name]}


def extract(folder: Path, force: float) -> Path:
    """A GNSS/INS log at 100 Hz, kept elsewhere, whose packets have this specific force."""
    writer, name = WRITERS["kitti-raw"]
    frames, packets = made_frames(FRAMES, True), made_packets(FRAMES)
    with writer(folder / name.replace("_sync", "_extract"), open_log(write_drive(folder / "rig", "kitti-raw")).rig) as drive:
        for frame in frames:
            drive.add(frame)
        for i in range(60):
            drive.add_gnss(replace(packets[0], t_ns=frames[0].t_ns + 10_000_000 * i, specific_force=(force, 0.0, 9.8)))
    return folder / name.replace("_sync", "_extract")


def test_an_imu_that_a_gnss_log_brings_from_outside_is_in_the_odometrys_key(tmp_path):
    log_path = write_drive(tmp_path / "log", "kitti-odometry", gnss=False)
    one, other = extract(tmp_path / "one", 0.5), extract(tmp_path / "other", 0.7)
    assert open_log(log_path, gnss=one).imu is not None
    before, after = keys_of(log_path, tmp_path / "a", one), keys_of(log_path, tmp_path / "b", other)
    assert changed(before, after) == {"ingest", "odometry", "georeference"}
    assert before == keys_of(log_path, tmp_path / "c", one)


def test_exposure_times_beside_the_log_are_a_part_of_it(tmp_path):
    log_path = write_drive(tmp_path / "log", "kitti-odometry", gnss=False)
    sample_files(log_path)
    log = open_log(log_path)
    before = {part: digest(log, "") for part, digest in LOG_PARTS.items()}
    lines = (log_path / "exposure.csv").read_text().splitlines()
    (log_path / "exposure.csv").write_text("\n".join([*lines[:-1], "0.5,0.5"]) + "\n")
    after = {part: digest(open_log(log_path), "") for part, digest in LOG_PARTS.items()}
    assert {part for part in before if before[part] != after[part]} == {"exposure", "images"}


def test_the_imus_place_counts_as_its_samples_do():
    log = SimpleNamespace(imu=made_imu(), T_cam_imu=T_CAM_IMU)
    moved = SimpleNamespace(imu=made_imu(), T_cam_imu=T_CAM_IMU + 1e-3 * np.eye(4))
    none, idle = SimpleNamespace(imu=None, T_cam_imu=None), SimpleNamespace(imu=None, T_cam_imu=T_CAM_IMU)
    assert len({LOG_PARTS["imu"](one, "") for one in (log, moved, none)}) == 3
    assert LOG_PARTS["imu"](idle, "") == LOG_PARTS["imu"](none, "")


def test_the_code_that_reads_the_format_is_in_the_keys_of_those_who_read_images(tmp_path, monkeypatch):
    log_path = write_drive(tmp_path / "log", "kitti-odometry")
    before = keys_of(log_path, tmp_path / "a")
    monkeypatch.setattr(LogSource, "reader_version", "another")
    assert changed(before, keys_of(log_path, tmp_path / "b")) == {"ingest", "odometry", "segmentation"}


def test_a_renamed_log_is_another_one_to_those_who_leave_its_name(tmp_path):
    log_path = write_drive(tmp_path / "log", "kitti-odometry")
    before = keys_of(log_path, tmp_path / "a")
    renamed = log_path.rename(log_path.with_name("another"))
    assert changed(before, keys_of(renamed, tmp_path / "b")) == {"ingest", "odometry", "segmentation"}


def test_library_versions_are_in_the_key(tmp_path, monkeypatch):
    log_path = write_drive(tmp_path / "log", "kitti-odometry")
    before = keys_of(log_path, tmp_path / "a")
    real = running.code_version

    def newer(room):
        found = real(room)
        return replace(found, libraries={**found.libraries, **({"numba": "99"} if "numba" in found.libraries else {})})

    monkeypatch.setattr(running, "code_version", newer)
    assert changed(before, keys_of(log_path, tmp_path / "b")) == {"odometry", "segmentation"}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (ProcessSettings(odometry=OdometrySettings(row_frames=(0,))), {"odometry"}),
        (ProcessSettings(labelling=LabellingSettings(between_keyframes=True)), {"segmentation"}),
        (ProcessSettings(labelling=LabellingSettings(right_images=5)), {"segmentation"}),
        (ProcessSettings(georeference=GeoReferenceSettings(position_noise_m=0.2)), {"georeference"}),
        (ProcessSettings(map_origin=(8.4, 49.0, 0.0)), {"georeference"}),
        (ProcessSettings(threads=3), set()),
    ],
)
def test_a_setting_is_in_the_keys_of_the_stages_whose_entry_names_it(tmp_path, settings, expected):
    log_path = write_drive(tmp_path / "log", "kitti-odometry")
    before = keys_of(log_path, tmp_path / "a")
    context = StageContext(LogSource(log_path), tmp_path / "a", settings)
    assert changed(before, {name: stage_key(name, context).hex for name in before}) == expected
