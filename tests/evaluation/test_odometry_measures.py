"""The numbers of the odometry's benchmark on results whose errors are known."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.errors import ConfigError, InputError
from wayloom.evaluation import odometry_density, odometry_depth, odometry_peers, odometry_table
from wayloom.evaluation.odometry import ABLATIONS, DEFAULT, Summary, drift, joined, replaced, run_measured, summarise
from wayloom.evaluation.odometry_recordings import (
    CLIP_A_WRONG_UNTIL,
    Recording,
    Thinned,
    clip_recordings,
    piece,
    recording_of,
    thinned,
)
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.registry import open_log
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

ROOT = Path(__file__).resolve().parents[2]
CAMERA = PinholeCamera(100.0, 100.0, 63.5, 47.5, 128, 96)
RIG = StereoRig(CAMERA, (-0.5, 0.0, 0.0))


def result_of(uv: np.ndarray, depth: np.ndarray, host: np.ndarray, obs: list[list[int]]) -> OdometryResult:
    """Points of three keyframes (frames 0, 2, 4 of five) 1 m apart along z."""
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 2, 3] = 0.5 * np.arange(5)
    n = len(uv)
    return OdometryResult(
        RIG,
        Trajectory(np.arange(5) * 10**8, T, np.ones(5, bool), np.zeros(5, np.int32)),
        Keyframes(np.array([0, 2, 4], np.int32), T[::2], np.zeros((3, 4)), np.zeros(3, np.int32)),
        Points(
            host.astype(np.int32), uv.astype(np.float32), (1 / depth).astype(np.float32), np.full(n, 1e-4, np.float32),
            np.full(n, 90, np.uint8), np.cumsum([0, *(len(o) for o in obs)]), np.array([k for o in obs for k in o], np.int32),
            np.ones(sum(len(o) for o in obs), bool), np.ones(n, bool),
        ),
        0.0, np.zeros(3), {"seconds": {}},
    )  # fmt: skip


class FlatTruth:
    """A wall `depth_m` before the camera in frame 2; its left half is road, its right half car."""

    frames = np.array([2])

    def __init__(self, depth_m: float, reach: int) -> None:
        self.depth_m, self.reach = depth_m, reach

    def at(self, frame: int, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        known = uv[:, 1] > 10
        return np.where(known, self.depth_m, np.nan), np.where(uv[:, 0] < 64, 0, 13).astype(np.uint8)


def test_depth_errors_count_what_lies_within_their_limits() -> None:
    uv = np.array([[20.0, 50], [40, 50], [100, 50], [60, 50], [60, 5], [60, 60]])
    depth = np.array([10.0, 10.05, 10.3, 14.0, 10.0, 10.0])
    result = result_of(uv, depth, np.array([1, 1, 1, 1, 1, 0]), [[0]] * 6)
    errors = odometry_depth.depth_errors(result, FlatTruth(10.0, 0), np.arange(5))
    assert errors.points == 4  # the fifth has no truth, the sixth is hosted elsewhere
    assert errors.within_5_percent == pytest.approx(3 / 4)
    assert errors.surface_within_10_cm == pytest.approx(2 / 3)
    assert errors.beyond_2_px == 0.0
    assert errors.median_px_sides == pytest.approx(np.median(50 * (1 / depth[[0, 2]] - 0.1)), abs=1e-4)


def test_points_of_neighbouring_frames_are_carried_into_the_frame_with_truth() -> None:
    result = result_of(np.array([[63.5, 47.5]]), np.array([11.0]), np.array([0]), [[1]])
    _, estimate, depth, _ = odometry_depth.compared_depths(result, FlatTruth(10.0, 2), np.arange(5))
    assert estimate == pytest.approx([10.0], abs=1e-4)  # the camera has come 1 m nearer
    assert depth.tolist() == [10.0]
    assert odometry_depth.depth_errors(result, FlatTruth(10.0, 1), np.arange(5)).points == 0


def test_laser_returns_behind_nearer_ones_are_not_seen() -> None:
    lidar = odometry_depth.LidarDepth({}, np.eye(4), CAMERA, np.zeros(0, np.int64))
    near = np.array([[x, 0.0, 5.0] for x in np.linspace(-1, 1, 41)])
    behind, beside = np.array([[0.0, 0.05, 20.0]]), np.array([[6.0, 0.0, 20.0]])
    uv, z = lidar.visible_returns(np.vstack([near, behind, beside]))
    assert len(z) == 42
    assert (z == 20.0).sum() == 1
    assert uv[z == 20.0][0] == pytest.approx([93.5, 47.5])


def test_blocks_with_texture_are_covered_by_the_points_a_keyframe_holds() -> None:
    image = np.full((96, 128), 100.0, np.float32)
    image[:, :64] += 60 * (np.indices((96, 64)).sum(axis=0) // 4 % 2)
    texture = odometry_density.textured_blocks(*odometry_density.slopes(image))
    assert texture.shape == (3, 4)
    assert texture[:, :2].all()
    assert not texture[:, 3].any()
    result = result_of(np.array([[10.0, 10], [40, 40], [110, 40]]), np.full(3, 10.0), np.array([1, 1, 0]), [[0], [0], [2]])
    uv = odometry_density.points_in_keyframe(result, 1)
    np.testing.assert_allclose(uv, [[10, 10], [40, 40]], atol=1e-4)
    assert odometry_density.covered(texture[:, :2], uv) == pytest.approx(2 / 6)
    assert len(odometry_density.points_in_keyframe(result, 2)) == 1


def test_a_summary_is_the_median_and_the_range_of_its_runs() -> None:
    summary = summarise("A", DEFAULT, [{"x": 1.0, "y": 2.0}, {"x": 4.0}, {"x": 2.0, "y": float("nan")}])
    assert summary.median == {"x": 2.0, "y": 2.0}
    assert summary.spread == {"x": 3.0, "y": 0.0}
    assert summarise("A", DEFAULT, [{"z": float("nan")}]).as_json()["median"] == {"z": None}


def test_runs_of_one_seed_each_are_joined_to_what_they_would_be_in_one() -> None:
    runs = [{"x": 1.0, "y": 2.0}, {"x": 4.0}, {"x": 2.0}]
    assert joined([summarise("A", DEFAULT, [run]) for run in runs]) == summarise("A", DEFAULT, runs)


def test_a_process_is_measured_by_itself_and_not_by_who_started_it() -> None:
    ours = np.ones(40_000_000)  # 320 MB in this process
    small, large = (
        run_measured([sys.executable, "-S", "-c", f"x = b'1' * {size}; import time; time.sleep(0.2)"]) for size in (1, 100_000_000)
    )
    assert small[0] == large[0] == 0
    assert small[2] < 60 < 100 < large[2] < 200
    assert small[1] > 0
    assert run_measured([sys.executable, "-c", "raise SystemExit(3)"])[0] == 3
    assert ours.all()


def test_every_ablation_is_a_setting_of_the_odometry() -> None:
    for changes in ABLATIONS.values():
        assert OdometrySettings.model_validate(changes) is not None


def test_a_share_of_runs_in_turn_is_not_taken_of_their_medians_again() -> None:
    numbers = {"frames": 10.0, "tracked": 10.0, "keyframes": 4.0, "cpu median ms": 20.0}
    ours, theirs = (10.0, 30.0, 12.0), (20.0, 40.0, 30.0)
    own = [{**numbers, "cpu mean ms": a, odometry_table.CPU_SHARE: a / b} for a, b in zip(ours, theirs, strict=True)]
    other = [{"frames": 10.0, "tracked": 10.0, "cpu mean ms": b} for b in theirs]
    page = odometry_table.page([summarise("A", DEFAULT, own), summarise("A", "prototype, fast", other)])
    assert "| A | wayloom | 4 | – | 12.0 ± 20.0 | 20.0 | – | 0.50 ± 0.35 |" in page


def test_the_page_has_a_row_for_each_system_and_a_dash_where_nothing_is_known() -> None:
    numbers = {"frames": 10.0, "tracked": 9.0, "cpu median ms": 20.0, "cpu mean ms": 21.0, "keyframes": 4.0, "ATE m (poses)": 0.123}
    own = summarise("A", DEFAULT, [numbers, {**numbers, "ATE m (poses)": 0.133}])
    other = summarise("A", "prototype, fast", [{"frames": 10.0, "tracked": 10.0, "ATE m (poses)": 0.5, "cpu mean ms": 14.0}])
    less = summarise("A", "no rows", [{**numbers, "points/m": 151.0}])
    elsewhere = summarise("B", DEFAULT, [numbers])
    page = odometry_table.page([own, other, less, elsewhere])
    assert "| A | poses | wayloom | 2 | 9 of 10 | 0.128 ± 0.010 | – |" in page
    assert "| A | wayloom | 4 | – | 21.0 | 20.0 | – | 1.50 |" in page
    assert "| A | prototype, fast | – | – | 14.0 |" in page
    assert "| variant | A: ATE m; t_rel % |" in page  # nothing is taken away on B
    assert "| no rows | 0.123; –, 1 lost |" in page
    assert "| no rows | 151; –, 1 lost |" in page
    assert "1 seed each; the first row" in page


def test_rows_that_were_measured_again_are_replaced_and_the_others_stay() -> None:
    old = [summarise(name, variant, [{"x": 1.0}]) for name in "AB" for variant in (DEFAULT, "no rows")]
    new = [summarise("C", DEFAULT, [{"x": 3.0}]), summarise("A", "no rows", [{"x": 2.0}, {"x": float("nan")}])]
    rows = replaced(old, new)
    assert [(row.recording, row.variant) for row in rows] == [(r.recording, r.variant) for r in (*old, new[0])]
    assert [row.median["x"] for row in rows] == [1.0, 2.0, 1.0, 1.0, 3.0]
    again = [Summary.from_json(json.loads(json.dumps(row.as_json()))) for row in rows]
    assert again == rows


def test_the_committed_page_is_what_the_committed_numbers_say() -> None:
    rows = [Summary.from_json(row) for row in json.loads((ROOT / "benchmarks" / "odometry.json").read_text())]
    assert (ROOT / "docs" / "benchmarks" / "odometry.md").read_text(encoding="utf-8") == odometry_table.page(rows)
    assert {row.variant for row in rows} >= set(ABLATIONS)


def test_clips_are_found_with_what_is_known_of_them(data_dir: Path) -> None:
    a, b = clip_recordings(data_dir)
    assert np.isnan(a.truths[f"poses from frame {CLIP_A_WRONG_UNTIL}"][:16]).all()
    assert b.depth is not None
    assert b.depth.frames.tolist() == [0, 24, 48, 72, 96, 120, 144]
    half = thinned(b, 2)
    assert len(half.log) == len(half.numbers) == 77
    assert half.log.frame(3).t_ns == b.log.t_ns[6]
    assert half.log.frame(3).index == 3
    some = piece(a, 20, 30)
    assert some.name == "A 20:30"
    assert some.log.frame(2).t_ns == a.log.t_ns[22]
    np.testing.assert_array_equal(some.truths["poses"], a.truths["poses"][20:30])
    with pytest.raises(InputError, match="201 frames, not 190 to 202"):
        piece(a, 190, 202)
    rays = CAMERA.rays(np.array([[10.0, 10.0]]))
    assert rays.shape == (1, 3)
    depth, classes = b.depth.at(24, np.array([[600.0, 300.0], [600.0, 5.0]]))
    assert 4 < depth[0] < 40
    assert np.isnan(depth[1])
    assert (classes == 255).all()


def test_a_drive_without_poses_cannot_judge(clip_b: Path) -> None:
    with pytest.raises(InputError, match="has no poses"):
        recording_of(clip_b)


def peer_script(folder: Path, body: str) -> str:
    script = folder / "peer.py"
    script.write_text("import pathlib, sys\nlog, out = map(pathlib.Path, sys.argv[1:])\n" + body)
    return f"{sys.executable} {script} {{log}} {{out}}"


def test_a_peer_is_given_a_kitti_folder_and_measured_by_its_poses(clip_b: Path, tmp_path: Path) -> None:
    log = Thinned(open_log(clip_b), np.arange(20))
    truth = np.tile(np.eye(4), (20, 1, 1))
    truth[:, 2, 3] = np.arange(20)
    recording = Recording("B", open_log(clip_b), np.arange(154), {}, None)
    count = "n = len(list((log / 'image_0').iterdir()))\nassert (log / 'calib.txt').is_file()\n"
    command = peer_script(tmp_path, count + "out.write_text('1 0 0 0 0 1 0 0 0 0 1 0\\n' * n)")
    assert odometry_peers.peer_measured(recording, command).median["tracked"] == 154
    with pytest.raises(ConfigError, match=r"lacks \{log\} or \{out\}"):
        odometry_peers.peer_measured(recording, "true {log}")
    with pytest.raises(InputError, match="status 3"):
        odometry_peers.peer_measured(recording, peer_script(tmp_path, "sys.exit(3)"))
    with pytest.raises(InputError, match="no rectified image files"):
        odometry_peers.kitti_folder(log, tmp_path)


def test_poses_are_read_in_both_formats(tmp_path: Path) -> None:
    T = se3.exp(np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]))
    (tmp_path / "kitti").write_text(" ".join(f"{x:.9f}" for x in T[:3].ravel()) + "\n")
    (tmp_path / "tum").write_text("# t x y z\n0.1 1 2 3 0 0 0 1\n")
    np.testing.assert_allclose(odometry_peers.read_poses(tmp_path / "kitti")[0], T, atol=1e-8)
    assert odometry_peers.read_poses(tmp_path / "tum")[0, :3, 3].tolist() == [1, 2, 3]
    (tmp_path / "none").write_text("")
    with pytest.raises(InputError, match="holds no pose"):
        odometry_peers.read_poses(tmp_path / "none")


def test_truth_images_are_read_at_the_nearest_pixel(tmp_path: Path) -> None:
    for kind, image in (("depth_left", np.full((4, 6), 512, np.uint16)), ("class_left", np.full((4, 6), 7, np.uint8))):
        (tmp_path / kind).mkdir()
        image[2, 3] = 0
        cv2.imwrite(str(tmp_path / kind / "000005.png"), image)
    truth = odometry_depth.TruthImages(tmp_path, np.array([5]))
    depth, classes = truth.at(5, np.array([[1.4, 1.0], [2.6, 2.4]]))
    assert depth[0] == 512 / odometry_depth.DEPTH_PER_M
    assert np.isnan(depth[1])
    assert classes.tolist() == [7, 0]


def test_the_drift_of_a_long_drive_is_told_for_its_first_and_last_kilometre() -> None:
    truth = np.tile(np.eye(4), (3001, 1, 1))
    truth[:, 2, 3] = np.arange(3001.0)
    estimate = truth.copy()
    estimate[2000:, 2, 3] += 0.01 * np.arange(1001)
    told = drift(estimate, truth)
    assert told["way km"] == pytest.approx(3.0)
    assert told["t_rel % first km"] == pytest.approx(0.0, abs=1e-9)
    assert told["t_rel % last km"] == pytest.approx(0.95, abs=0.06)
    assert drift(estimate[:1500], truth[:1500]) == {}
