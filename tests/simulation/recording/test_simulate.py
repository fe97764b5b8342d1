"""Whole drives: what is written, byte for byte, however often the run is stopped."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from wayloom.config.classes import CLASS_COUNT
from wayloom.errors import ConfigError, ConflictError, LogError
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.geometry import se3
from wayloom.logs.registry import open_log
from wayloom.logs.simulated_truth import FIX_COLUMNS, open_truth
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.presets import CITY_ORIGIN, PRESETS, START_NS, DrivePlan, Preset
from wayloom.simulation.recording.record_drive import plan_recording, route_plan
from wayloom.simulation.recording.simulate import WRITERS, OutputSettings, PresetVariant, simulate
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.traffic.drives import plan_drives
from wayloom.simulation.vehicle.rigs import given_rig
from wayloom.simulation.vehicle.vehicle_settings import (
    ExposureSettings,
    ImuSettings,
    LidarSettings,
    SensorSettings,
    VehicleSettings,
)

FRAMES = 4
LIDAR = LidarSettings(rings=16, columns=256)


def digests(folder: Path) -> dict[str, str]:
    return {
        f.relative_to(folder).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest()
        for f in sorted(folder.rglob("*"))
        if f.is_file()
    }


@pytest.fixture(scope="module")
def preset() -> Preset:
    """One drive with everything that a vehicle can have: LiDAR, IMU, exposure control."""
    vehicle = VehicleSettings(
        right=SensorSettings(gain=1.03), imu=ImuSettings(), lidar=LIDAR, exposure=ExposureSettings(logged=True, time_constant_s=0.3)
    )
    plan = DrivePlan(vehicle_id="one", nodes=(3, 4, 7), reference=1, before_m=25.0, frames=FRAMES, start_s=3.0, vehicle=vehicle)
    return Preset(name="short", about="for tests", city=CitySettings(seed=11, columns=3, rows=3), drives=(plan,))


@pytest.fixture(scope="module")
def city(preset: Preset) -> World:
    """The preset's."""
    return build_world(preset.city, preset.light, "quarter")


@pytest.fixture(scope="module")
def written(preset: Preset, city: World, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The drive in every format, by one thread."""
    folder = tmp_path_factory.mktemp("drives")
    return {
        layout: simulate(preset, folder / layout, OutputSettings("quarter", format=layout, truth=True), world=city)[0]
        for layout in WRITERS
    }


@pytest.mark.parametrize("layout", list(WRITERS))
def test_two_runs_are_alike_to_the_byte_and_so_are_one_and_two_threads(
    layout: str, written: dict[str, Path], preset: Preset, city: World, tmp_path: Path
) -> None:
    expected = digests(written[layout].parent)
    simulate(
        preset, tmp_path, OutputSettings("quarter", format=layout, truth=True), threads=2, world=city if layout != "kitti" else None
    )
    assert digests(tmp_path) == expected
    assert not [name for name in expected if Path(name).name.startswith(".")]


@pytest.mark.parametrize("layout", list(WRITERS))
def test_a_run_that_is_stopped_goes_on_and_ends_with_the_same_bytes(
    layout: str, written: dict[str, Path], preset: Preset, city: World, tmp_path: Path
) -> None:
    def stop(share: float, what: str) -> None:
        if f"frame 2 of {FRAMES}" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(preset, tmp_path, OutputSettings("quarter", format=layout, truth=True), threads=2, progress=stop, world=city)
    assert {f.name for f in tmp_path.iterdir()} == {".one.unfinished", "simulation.json"}
    told: list[str] = []
    simulate(
        preset,
        tmp_path,
        OutputSettings("quarter", format=layout, truth=True),
        progress=lambda _, what: told.append(what),
        world=city,
    )
    assert f"one: frame 1 of {FRAMES}" not in told
    assert f"one: frame 3 of {FRAMES}" in told
    assert digests(tmp_path) == digests(written[layout].parent)


def test_a_process_that_is_killed_leaves_nothing_half_written(
    written: dict[str, Path], preset: Preset, city: World, tmp_path: Path
) -> None:
    script = textwrap.dedent(
        f"""
        import os, signal
        from pathlib import Path
        from wayloom.simulation.recording.presets import Preset
        from wayloom.simulation.recording.simulate import OutputSettings, simulate

        def stop(share, what):
            if "frame 3 of" in what:
                os.kill(os.getpid(), signal.SIGKILL)

        preset = Preset.model_validate_json({preset.model_dump_json()!r})
        simulate(preset, Path({str(tmp_path)!r}), OutputSettings("quarter", truth=True), progress=stop)
        """
    )
    ended = subprocess.run([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": "core"}, check=False)
    assert ended.returncode == -signal.SIGKILL
    torn = tmp_path / ".one.unfinished"
    (torn / "drive" / "image_2" / ".unfinished-abc").write_bytes(b"cut")
    with (torn / "journal.txt").open("ab") as journal:
        journal.write(b"3 0.9")
    simulate(preset, tmp_path, OutputSettings("quarter", truth=True), world=city)
    assert digests(tmp_path) == digests(written["kitti"].parent)


def test_a_full_disk_is_told_and_the_run_goes_on_when_there_is_space(
    written: dict[str, Path], preset: Preset, city: World, tmp_path: Path
) -> None:
    script = textwrap.dedent(
        f"""
        import resource, sys
        from wayloom.cli import main
        from wayloom.simulation.recording import presets
        presets.PRESETS["short"] = presets.Preset.model_validate_json({preset.model_dump_json()!r})
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
        sys.argv = ["wayloom", "simulate", "short", "--out", {str(tmp_path)!r}, "--size", "quarter", "--truth"]
        main.main()
        """
    )
    run = [sys.executable, "-c", script]
    ended = subprocess.run(run, env={**os.environ, "PYTHONPATH": "core"}, check=False, capture_output=True, text=True)
    assert ended.returncode == 2
    *progress, error = ended.stderr.splitlines()
    assert all(line.startswith("simulating short ") for line in progress)
    assert "cannot be written (File too large)" in error
    simulate(preset, tmp_path, OutputSettings("quarter", truth=True), world=city)
    assert digests(tmp_path) == digests(written["kitti"].parent)


def test_a_drive_that_is_there_is_not_drawn_again(written: dict[str, Path], preset: Preset, city: World) -> None:
    drive = written["kitti"]
    before = {f: f.stat().st_mtime_ns for f in drive.rglob("*")}
    left_over = drive.parent / ".one.unfinished" / "spool"
    left_over.mkdir(parents=True)
    assert simulate(preset, drive.parent, OutputSettings("quarter", truth=True), world=city) == [drive]
    assert {f: f.stat().st_mtime_ns for f in drive.rglob("*")} == before
    assert not left_over.parent.exists()


def test_a_folder_of_other_settings_is_refused_with_the_difference(written: dict[str, Path], preset: Preset, city: World) -> None:
    folder = written["kitti"].parent
    with pytest.raises(LogError, match=r"other settings \(preset.city.seed: 11, not 12\)"):
        simulate(preset, folder, OutputSettings("quarter", truth=True), PresetVariant(seed=12), world=city)
    with pytest.raises(LogError, match="truth: true, not false"):
        simulate(preset, folder, OutputSettings("quarter"), world=city)


def test_two_runs_do_not_write_into_one_folder(preset: Preset, city: World, tmp_path: Path) -> None:
    def second(share: float, what: str) -> None:
        if "frame" in what:
            simulate(preset, tmp_path, OutputSettings("quarter"), world=city)

    with pytest.raises(ConflictError, match="another simulation"):
        simulate(preset, tmp_path, OutputSettings("quarter"), progress=second, world=city)


def test_another_seed_is_another_city(preset: Preset, written: dict[str, Path], tmp_path: Path) -> None:
    (other,) = simulate(preset, tmp_path, OutputSettings("quarter"), PresetVariant(seed=12, frames=2))
    assert (other / "image_2" / "000000.png").read_bytes() != (written["kitti"] / "image_2" / "000000.png").read_bytes()
    assert len(open_log(other)) == 2


@pytest.mark.parametrize("layout", list(WRITERS))
def test_a_drive_is_read_back_with_its_rig_truth_and_sensors(layout: str, preset: Preset, written: dict[str, Path]) -> None:
    log, plan = open_log(written[layout]), preset.drives[0]
    assert (len(log), log.colour, log.vehicle_id, log.rig_id) == (FRAMES, True, "one", "simulated-short-one")
    assert log.rig.camera == given_rig(plan.vehicle, "quarter").camera
    assert log.rig.baseline_m == pytest.approx(0.594)
    np.testing.assert_allclose(log.p_cam_gnss, plan.vehicle.p_cam_gnss_m, atol=1e-12)
    frame = log.frame(FRAMES - 1)
    assert frame.right.shape == (94, 352, 3)
    assert frame.exposure_s is not None
    assert 1e-4 < frame.exposure_s[0] < 0.1
    assert log.t_ns[0] == START_NS + 3_000_000_000
    assert np.diff(log.t_ns).tolist() == [100_000_000] * (FRAMES - 1)
    truth = open_truth(written[layout])
    assert log.truth is not None
    relative = se3.inverse(log.truth[0]) @ log.truth
    np.testing.assert_allclose(relative, se3.inverse(truth.T_enu_cam[0]) @ truth.T_enu_cam, atol=1e-8)
    assert log.gnss is not None
    assert len(log.gnss) == FRAMES
    origin = [CITY_ORIGIN.lon_deg, CITY_ORIGIN.lat_deg, CITY_ORIGIN.height_m]
    assert log.gnss.lon_lat_height[0] == pytest.approx(origin, abs=20)
    assert log.imu is not None
    assert len(log.imu.t_ns) == 10 * (FRAMES - 1) + 1
    assert np.median(np.linalg.norm(log.imu.specific_force, axis=1)) == pytest.approx(9.81, abs=1.0)
    assert log.T_cam_imu is not None
    np.testing.assert_allclose(log.T_cam_imu, plan.vehicle.T_cam_imu, atol=1e-12)


def test_pictures_of_all_formats_are_the_same(written: dict[str, Path]) -> None:
    frames = [open_log(path).frame(2) for path in written.values()]
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.left, frames[0].left)
        np.testing.assert_array_equal(frame.right, frames[0].right)


def test_pictures_are_neither_dark_nor_white(written: dict[str, Path]) -> None:
    image = cv2.imread(str(written["kitti"] / "image_2" / "000003.png"))
    assert 50 < image.mean() < 190
    assert image.std() > 20


def test_truth_holds_depth_class_and_instance_of_both_cameras(written: dict[str, Path]) -> None:
    truth = open_truth(written["kitti"])
    assert len(truth) == FRAMES
    for camera in ("left", "right"):
        depth, label, instance = truth.depth_m(2, camera), truth.class_id(2, camera), truth.instance(2, camera)
        assert label.shape == depth.shape == instance.shape == (94, 352)
        assert label.max() < CLASS_COUNT
        assert 1.0 < np.median(depth[depth > 0]) < 60.0
    points = np.fromfile(written["kitti"] / "velodyne" / "000002.bin", "<f4").reshape(-1, 4)
    labels, things = truth.scan_labels(2)
    assert len(points) == len(labels) == len(things) > 1000


def test_every_point_of_truths_surface_is_a_pixel_of_some_frame(written: dict[str, Path]) -> None:
    truth, camera = open_truth(written["kitti"]), open_log(written["kitti"]).rig.camera
    surface = truth.surface()
    found = np.zeros(len(surface.labels), bool)
    for index, T in enumerate(truth.T_enu_cam):
        p_cam = (surface.points_enu - T[:3, 3]) @ T[:3, :3]
        uv = camera.project(p_cam)
        inside = np.flatnonzero(camera.contains(np.rint(uv)))
        u, v = np.rint(uv[inside]).astype(int).T
        same = np.abs(uv[inside] - np.column_stack([u, v])).max(axis=1) < 1e-6
        same &= np.abs(truth.depth_m(index)[v, u] - p_cam[inside, 2]) < 1e-6
        same &= (truth.class_id(index)[v, u] == surface.labels[inside]) & (truth.instance(index)[v, u] == surface.instances[inside])
        found[inside[same]] = True
    assert len(found) > 20_000
    assert found.all()


def test_truth_tells_the_rig_the_frames_and_the_city(written: dict[str, Path], preset: Preset) -> None:
    truth = open_truth(written["kitti"])
    vehicle, frames = truth.vehicle(), truth.frames()
    assert VehicleSettings.model_validate(vehicle["vehicle"]) == preset.drives[0].vehicle
    assert vehicle["given_rig"]["fx"] == pytest.approx(552.55 / 4)
    log = open_log(written["kitti"])
    np.testing.assert_array_equal(frames.t_ns, log.t_ns)
    said = [log.frame(index).exposure_s for index in range(FRAMES)]
    np.testing.assert_allclose(frames.exposure_s * frames.gain, said)
    assert frames.imu_bias is not None
    assert frames.imu_bias.shape == (FRAMES, 6)
    assert 0 < np.abs(frames.imu_bias).max() < 0.5
    for name in ("objects.geojson", "areas.geojson", "markings.geojson"):
        assert json.loads((truth.folder / name).read_text())["type"] == "FeatureCollection"


def test_truth_tells_how_far_each_fix_is_off(written: dict[str, Path]) -> None:
    rows = np.genfromtxt(written["kitti"] / "truth" / "fixes.csv", delimiter=",", names=True, dtype=None, encoding="ascii")
    log = open_log(written["kitti"])
    assert log.gnss is not None
    assert len(rows) == len(log.gnss)
    place, error = (np.column_stack([rows[name] for name in names]) for names in (FIX_COLUMNS[1:4], FIX_COLUMNS[4:7]))
    np.testing.assert_allclose(place + error, enu_from_lonlatheight(log.gnss.lon_lat_height, CITY_ORIGIN), atol=1e-4)
    antenna = open_truth(written["kitti"]).T_enu_cam[0] @ np.append(log.p_cam_gnss, 1.0)
    np.testing.assert_allclose(place[0], antenna[:3], atol=1e-5)


def test_what_is_unknown_is_refused_with_the_known(tmp_path: Path, preset: Preset) -> None:
    with pytest.raises(ConfigError, match="unknown preset 'moon'; use one of demo"):
        simulate("moon", tmp_path)
    with pytest.raises(ConfigError, match="kitti, kitti-raw, kitti-360"):
        simulate(preset, tmp_path, OutputSettings(format="rosbag"))
    with pytest.raises(ConfigError, match="full, half, quarter"):
        simulate(preset, tmp_path, OutputSettings(size="tiny"))
    with pytest.raises(ConfigError, match="no drive 'two' in short; use some of one"):
        simulate(preset, tmp_path, variant=PresetVariant(drives=("two",)))
    with pytest.raises(ConfigError, match="short does not go in laps"):
        simulate(preset, tmp_path, variant=PresetVariant(laps=3))
    bent = preset.drives[0].vehicle.model_copy(update={"distortion": (-0.2, 0.05, 0.0, 0.0, 0.0)})
    drive = preset.drives[0].model_copy(update={"vehicle": bent})
    with pytest.raises(ConfigError, match="images of one are distorted, kitti holds rectified ones; use kitti-raw"):
        simulate(preset.model_copy(update={"drives": (drive,)}), tmp_path)
    assert not any(tmp_path.iterdir())


def test_a_drive_that_would_leave_its_streets_is_refused(preset: Preset, tmp_path: Path) -> None:
    far, quiet = preset.drives[0].model_copy(update={"frames": 400}), preset.city.model_copy(update={"traffic": 0.0})
    with pytest.raises(ConfigError, match="drives off its end"):
        simulate(preset.model_copy(update={"drives": (far,), "city": quiet}), tmp_path, OutputSettings("quarter"))
    assert not any(tmp_path.iterdir())


def test_a_folder_with_files_is_left_alone(preset: Preset, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "mine.txt").write_text("mine")
    with pytest.raises(LogError, match="no empty folder"):
        simulate(preset, tmp_path, OutputSettings("quarter"))
    assert [f.name for f in tmp_path.rglob("*")] == ["one", "mine.txt"]


def test_the_demo_drives_share_most_of_their_way() -> None:
    demo = PRESETS["demo"]
    world = build_world(demo.city, demo.light, "quarter")
    planned = plan_drives(world.city, [route_plan(plan, demo) for plan in demo.drives])
    one, two = (plan_recording(demo, number, drive).T_enu_cam[:, :2, 3] for number, drive in enumerate(planned))
    gap = np.linalg.norm(one[:, None] - two, axis=2)
    assert np.mean(gap.min(axis=1) < 8.0) > 0.5
    for way in (one, two):
        assert 60 < np.linalg.norm(np.diff(way, axis=0), axis=1).sum() < 110


@pytest.mark.parametrize("layout", ["kitti", "mcap"])
def test_laps_are_drawn_once_and_join_without_a_seam(layout: str, tmp_path: Path) -> None:
    vehicle = VehicleSettings(imu=ImuSettings(), exposure=ExposureSettings(compensation=0.0))
    plan = DrivePlan(vehicle_id="one", nodes=(5, 6, 10, 9), closed=True, start_s=3.0, vehicle=vehicle)
    still = CitySettings(seed=11, columns=4, rows=4, traffic=0.0, people=0.0)
    around = Preset(name="around", about="for tests", city=still, laps=2, rate_hz=0.2, drives=(plan,))
    (drive,) = simulate(
        around, tmp_path / "out", OutputSettings("quarter", format=layout, truth=layout == "kitti"), PresetVariant(laps=3)
    )
    log = open_log(drive)
    lap = len(log) // 3
    assert (len(log) % 3, lap > 3) == (0, True)
    assert log.truth is not None
    assert log.gnss is not None
    assert log.imu is not None
    np.testing.assert_allclose(log.truth[lap:], log.truth[:-lap], atol=1e-8)
    steps_m = np.linalg.norm(np.diff(log.truth[:, :3, 3], axis=0), axis=1)
    assert steps_m[lap - 1] == pytest.approx(steps_m[2 * lap - 1])
    assert np.ptp(np.diff(log.t_ns)) <= 1
    assert log.gnss.t_ns[-1] == pytest.approx(log.t_ns[-1], abs=1e8)
    jumps = np.linalg.norm(np.diff(log.imu.specific_force, axis=0), axis=1)
    seam = np.abs(log.imu.t_ns[1:] - log.t_ns[lap]) < 2e8
    assert jumps[seam].max() <= jumps[~seam].max()
    for index in (0, lap - 1):
        np.testing.assert_array_equal(log.frame(index).left, log.frame(index + 2 * lap).left)
    if layout == "kitti":
        name = (drive / "image_2" / "000001.png", drive / "image_2" / f"{lap + 1:06d}.png")
        assert name[0].samefile(name[1])
        truth = open_truth(drive)
        np.testing.assert_array_equal(truth.depth_m(1), truth.depth_m(1 + 2 * lap))
        assert len(truth) == len(truth.frames().t_ns) == len(log)


def test_a_preset_in_laps_is_of_a_still_city_and_closed_ways() -> None:
    long = PRESETS["long"]
    with pytest.raises(ValidationError, match="laps need whole closed drives, and a city without traffic"):
        Preset.model_validate({**long.model_dump(), "city": {**long.city.model_dump(), "traffic": 1.0}})
    with pytest.raises(ValidationError, match="a drive that does not close needs a number of frames"):
        DrivePlan(vehicle_id="one", nodes=(5, 6), start_s=0.0)
    with pytest.raises(ValidationError, match="two drives have the same vehicle_id"):
        Preset.model_validate({**long.model_dump(), "drives": [long.drives[0].model_dump()] * 2})
