"""Whole drives: what is written, byte for byte."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.config.classes import CLASS_COUNT
from wayloom.errors import ConfigError, LogError
from wayloom.geometry import se3
from wayloom.logs.registry import open_log
from wayloom.simulation.dataset import render_views
from wayloom.simulation.presets import CITY_ORIGIN, PRESETS, Preset
from wayloom.simulation.rigs import sized_rig
from wayloom.simulation.simulate import plan_route, simulate
from wayloom.simulation.worlds import build_world


def digests(folder: Path) -> dict[str, str]:
    return {
        f.relative_to(folder).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest()
        for f in sorted(folder.rglob("*"))
        if f.is_file()
    }


@pytest.fixture(scope="module")
def driven(short_preset: Preset, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return simulate(short_preset, tmp_path_factory.mktemp("drives"), "quarter", truth=True)


def test_two_runs_are_alike_to_the_byte_and_so_are_one_and_two_threads(
    driven: list[Path], short_preset: Preset, tmp_path: Path
) -> None:
    expected = digests(driven[0].parent)
    assert len(expected) > 2 * 5 * 8
    simulate(short_preset, tmp_path / "again", "quarter", truth=True, threads=2)
    assert digests(tmp_path / "again") == expected


def test_another_seed_is_another_city(short_preset: Preset, driven: list[Path], tmp_path: Path) -> None:
    one = short_preset.model_copy(update={"drives": short_preset.drives[:1]})
    (other,) = simulate(one, tmp_path, "quarter", seed=12)
    assert (other / "image_2" / "000000.png").read_bytes() != (driven[0] / "image_2" / "000000.png").read_bytes()


@pytest.mark.parametrize("layout", ["kitti", "kitti-raw"])
def test_a_drive_is_read_back_with_its_rig_truth_and_gnss(layout: str, short_preset: Preset, tmp_path: Path) -> None:
    one = short_preset.model_copy(update={"drives": short_preset.drives[1:]})
    (path,) = simulate(one, tmp_path, "quarter", format=layout)
    log = open_log(path)
    rig = sized_rig("quarter")
    assert len(log) == 5
    assert log.colour
    assert log.vehicle_id == "two"
    assert log.rig.camera == rig.camera
    assert log.rig.baseline_m == pytest.approx(0.594)
    np.testing.assert_allclose(log.p_cam_gnss, one.drives[0].p_cam_gnss_m)
    assert log.frame(4).right.shape == (94, 352, 3)
    assert np.diff(log.t_ns).tolist() == [100_000_000] * 4
    world = build_world(one.seed, one.columns, one.rows, one.light, "quarter")
    route = plan_route(world, one.drives[0], one.rate_hz)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth, se3.inverse(route.T_enu_cam[0]) @ route.T_enu_cam, atol=1e-8)
    assert log.gnss is not None
    assert len(log.gnss) == 5
    assert log.gnss.lon_lat_height[0] == pytest.approx([CITY_ORIGIN.lon_deg, CITY_ORIGIN.lat_deg, CITY_ORIGIN.height_m], abs=10)


def test_truth_files_hold_depth_class_and_instance_of_both_cameras(driven: list[Path]) -> None:
    truth = driven[0] / "truth"
    for camera in ("left", "right"):
        depth, label, instance = (
            cv2.imread(str(truth / f"{kind}_{camera}" / "000002.png"), cv2.IMREAD_UNCHANGED)
            for kind in ("depth", "class", "instance")
        )
        assert depth.dtype == np.uint16
        assert instance.dtype == np.uint16
        assert label.shape == depth.shape == (94, 352)
        assert label.max() < CLASS_COUNT
        assert 1.0 < np.median(depth[depth > 0]) / 256 < 60.0
    poses = np.loadtxt(truth / "poses_enu.txt").reshape(-1, 3, 4)
    assert poses.shape == (5, 3, 4)
    assert poses[0, 2, 3] < 10


def test_pictures_are_neither_dark_nor_white(driven: list[Path]) -> None:
    for path in driven:
        image = cv2.imread(str(path / "image_2" / "000004.png"))
        assert 60 < image.mean() < 180
        assert image.std() > 25


def test_what_is_unknown_is_refused_with_the_known(tmp_path: Path, short_preset: Preset) -> None:
    with pytest.raises(ConfigError, match="unknown preset 'moon'; use one of demo"):
        simulate("moon", tmp_path)
    with pytest.raises(ConfigError, match="kitti, kitti-raw"):
        simulate(short_preset, tmp_path, format="rosbag")
    with pytest.raises(ConfigError, match="full, half, quarter"):
        simulate(short_preset, tmp_path, size="tiny")
    assert not any(tmp_path.iterdir())


def test_a_drive_that_would_leave_its_streets_is_refused(short_preset: Preset, tmp_path: Path) -> None:
    far = short_preset.drives[0].model_copy(update={"frames": 400})
    with pytest.raises(ConfigError, match="drives off its end"):
        simulate(short_preset.model_copy(update={"drives": (far,)}), tmp_path, "quarter")
    assert not any(tmp_path.iterdir())


def test_a_folder_with_files_is_left_alone(short_preset: Preset, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "mine.txt").write_text("mine")
    with pytest.raises(LogError, match="no empty folder"):
        simulate(short_preset, tmp_path, "quarter")
    assert [f.name for f in tmp_path.rglob("*")] == ["one", "mine.txt"]


def test_a_run_that_is_stopped_leaves_nothing_half_written(short_preset: Preset, tmp_path: Path) -> None:
    def stop(share: float, what: str) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(short_preset, tmp_path, "quarter", progress=stop)
    assert not any(tmp_path.iterdir())


def test_the_demo_drives_share_most_of_their_way() -> None:
    demo = PRESETS["demo"]
    world = build_world(demo.seed, demo.columns, demo.rows, demo.light, "quarter")
    one, two = (plan_route(world, plan, demo.rate_hz) for plan in demo.drives)
    gap = np.hypot(one.x[:, None] - two.x, one.y[:, None] - two.y)
    assert np.mean(gap.min(axis=1) < 8.0) > 0.5
    for route in (one, two):
        length = np.hypot(np.diff(route.x), np.diff(route.y)).sum()
        assert 60 < length < 110


def test_training_views_are_colour_pictures_with_classes_and_follow_their_seed() -> None:
    views = list(render_views(1000, 2, "quarter"))
    for rgb, label in views:
        assert rgb.shape == (94, 352, 3)
        assert rgb.dtype == label.dtype == np.uint8
        assert len(np.unique(label)) >= 5
    again = next(iter(render_views(1000, 1, "quarter")))
    np.testing.assert_array_equal(again[0], views[0][0])
