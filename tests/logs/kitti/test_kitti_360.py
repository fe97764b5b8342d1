"""KITTI-360's layout: what is written comes back, and what is published is understood."""

import shutil
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from logs.made_drives import FRAMES, RIG, T_CAM_IMU, made_frames, made_packets, made_poses, write_drive
from wayloom.config.classes import CLASS_COUNT
from wayloom.errors import CalibrationError, LogError, UnknownFormatError
from wayloom.geometry import se3
from wayloom.logs.drive_writer import SensorExtrinsics
from wayloom.logs.kitti import kitti_360_labels as labels
from wayloom.logs.kitti.accumulation import OVERLAP_M, VOXEL_M, WINDOW_M, VoxelFilter, window_frames
from wayloom.logs.kitti.kitti_360_clouds import T_cam_lidar, T_cam_pose, read_cloud, read_scan, windows
from wayloom.logs.kitti.kitti_360_layout import Sequence, find_sequence, find_sequences
from wayloom.logs.kitti.kitti_360_writer import Kitti360Writer
from wayloom.logs.registry import open_log

T_CAM_LIDAR = se3.from_rotation_translation(
    se3.exp(np.array([0.0, 0.0, 0.0, 0.02, -0.01, 0.03]))[:3, :3] @ T_CAM_IMU[:3, :3], np.array([0.05, -0.4, -0.6])
)
UTM_LIKE = np.array([455_000.25, 5_427_000.5, 116.0])
POINTS = 400


def far_poses(offset: np.ndarray) -> np.ndarray:
    """The made poses, turned from forward-z to a map's axes and moved far away."""
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return se3.from_rotation_translation(axes, offset) @ made_poses(FRAMES)


def made_scan(index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """points (N, 4), train ids, things, moving: ahead of the LiDAR, some of them car 60007, which moves."""
    rng = np.random.default_rng(index)
    points = np.column_stack([rng.uniform(4, 20, POINTS), rng.uniform(-4, 4, (POINTS, 2)), rng.random(POINTS)]).astype(np.float32)
    class_id = rng.choice([0, 2, 5, 13], POINTS).astype(np.uint8)
    things = np.where(class_id == 13, 60_007, np.where(class_id == 0, 0, 40 + class_id.astype(int))).astype(np.uint16)
    return points, class_id, things, class_id == 13


@pytest.fixture(scope="module", params=[np.zeros(3), UTM_LIKE], ids=["near", "far"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A root with labels, scans and clouds, and its T_world_cam."""
    root, poses = tmp_path_factory.mktemp("data") / "made", far_poses(request.param)
    rng = np.random.default_rng(1)
    with Kitti360Writer(root, RIG, extrinsics=SensorExtrinsics(T_cam_imu=T_CAM_IMU, T_cam_lidar=T_CAM_LIDAR)) as drive:
        for frame, T in zip(made_frames(FRAMES, True), poses, strict=True):
            drive.add(frame, T)
            for side in (0, 1):
                class_id = rng.integers(0, CLASS_COUNT, (40, 64)).astype(np.uint8)
                drive.write_labels(frame.index, side, class_id, rng.integers(0, 2000, (40, 64)))
            drive.write_lidar(frame.index, *made_scan(frame.index))
        for packet in made_packets(FRAMES):
            drive.add_gnss(packet)
    return root, poses


def test_poses_come_back_exactly_however_far_the_world_is(written: tuple[Path, np.ndarray]) -> None:
    root, poses = written
    log = open_log(root)
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth, poses)
    (find_sequence(root).poses / "cam0_to_world.txt").rename(root / "aside")
    again = open_log(root).truth
    (root / "aside").rename(find_sequence(root).poses / "cam0_to_world.txt")
    assert again is not None
    np.testing.assert_allclose(again[:, :3, :3], poses[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(again[:, :3, 3], poses[:, :3, 3], atol=1e-8)


def test_label_images_come_back_as_train_ids(written: tuple[Path, np.ndarray]) -> None:
    sequence = find_sequence(written[0])
    rng = np.random.default_rng(1)
    for frame in range(FRAMES):
        for side in (0, 1):
            class_id = rng.integers(0, CLASS_COUNT, (40, 64)).astype(np.uint8)
            things = rng.integers(0, 2000, (40, 64))
            assert labels.has_labels(sequence, frame, side)
            np.testing.assert_array_equal(labels.read_semantic(sequence, frame, side), class_id)
            found = cv2.imread(str(sequence.label_image("instance", frame, side)), cv2.IMREAD_UNCHANGED)
            assert found.dtype == np.uint16
            np.testing.assert_array_equal(found // 1000, labels.ID_OF_TRAIN_ID[class_id])
            with_number = np.isin(labels.ID_OF_TRAIN_ID[class_id], list(labels.WITH_INSTANCES)) & (things > 0)
            np.testing.assert_array_equal(found % 1000 > 0, with_number)
    assert not labels.has_labels(sequence, FRAMES)
    with pytest.raises(LogError, match="labels some frames only"):
        labels.read_semantic(sequence, FRAMES)


def test_scans_and_their_place_come_back(written: tuple[Path, np.ndarray]) -> None:
    sequence = find_sequence(written[0])
    np.testing.assert_array_equal(read_scan(sequence.scan(3)), made_scan(3)[0])
    np.testing.assert_allclose(T_cam_lidar(sequence), T_CAM_LIDAR, atol=1e-12)
    forward = T_cam_pose(sequence)[:3, 0]
    np.testing.assert_allclose(forward, T_CAM_IMU[:3, 0], atol=1e-12)
    np.testing.assert_allclose(T_cam_pose(sequence)[:3, 2], -T_CAM_IMU[:3, 2], atol=1e-12)


def test_accumulated_clouds_hold_the_scans_points_in_the_world(written: tuple[Path, np.ndarray]) -> None:
    root, poses = written
    sequence = find_sequence(root)
    (static,) = windows(sequence, "static")
    (dynamic,) = windows(sequence, "dynamic")
    assert (static.first, static.last) == (dynamic.first, dynamic.last) == (0, FRAMES - 1)
    still, moving = read_cloud(static.file), read_cloud(dynamic.file)
    expected = {kind: [] for kind in ("still", "moving")}  # type: dict[str, list[np.ndarray]]
    for frame in range(FRAMES):
        points, class_id, things, moves = made_scan(frame)
        T = poses[frame] @ T_CAM_LIDAR
        p_world = points[:, :3].astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        rows = np.column_stack([p_world, class_id, things, np.full(POINTS, frame)])
        expected["still"].append(rows[~moves])
        expected["moving"].append(rows[moves])
    rows = np.concatenate(expected["moving"])
    np.testing.assert_allclose(moving.points, rows[:, :3], atol=2e-3 if np.abs(poses[:, :3, 3]).max() < 1e4 else 1e-8)
    np.testing.assert_array_equal(moving.frame, rows[:, 5])
    assert set(moving.semantic.tolist()) == {26}
    assert set(moving.instance.tolist()) == {26_000 + 1 + (60_007 - 1) % 999}
    rows = np.concatenate(expected["still"])
    assert 0.5 * len(rows) < len(still.points) <= len(rows)
    nearest = np.linalg.norm(still.points[:50, None] - rows[:, :3], axis=2)
    assert nearest.min(axis=1).max() < 2e-3
    np.testing.assert_array_equal(labels.train_ids(still.semantic[:50]), rows[nearest.argmin(axis=1), 3])
    assert (still.frame == -1).all()
    assert 0 < still.visible.mean() < 1
    assert (still.colours[~still.visible] == 0).all()


def test_of_points_in_a_voxel_the_first_is_kept() -> None:
    rng = np.random.default_rng(3)
    thinner, seen = VoxelFilter(), set[tuple[int, ...]]()
    for _ in range(40):
        points = rng.uniform(-2, 2, (200, 3))
        expected = []
        for row, cell in enumerate(np.floor(points / VOXEL_M).astype(int).tolist()):
            if tuple(cell) not in seen:
                seen.add(tuple(cell))
                expected.append(row)
        assert thinner.new(points).tolist() == expected


def test_windows_cover_the_way_and_overlap() -> None:
    T = np.tile(np.eye(4), (900, 1, 1))
    T[:, 0, 3] = 0.9 * np.arange(900)
    found = window_frames(T)
    assert found[0][0] == 0
    assert found[-1][1] == 899
    for (_, last), (first, _) in pairwise(found):
        assert OVERLAP_M - 0.9 <= 0.9 * (last - first) < OVERLAP_M + 1
    assert all(0.9 * (last - first) <= WINDOW_M + OVERLAP_M + 1 for first, last in found)
    assert window_frames(T[:5]) == [(0, 4)]
    assert window_frames(np.tile(np.eye(4), (5, 1, 1))) == [(0, 4)]


def test_the_published_table_of_ids() -> None:
    assert len(labels.NAMES) == 45
    by_name = {name: int(labels.TRAIN_ID_OF_ID[number]) for number, name in enumerate(labels.NAMES)}
    assert by_name["road"] == 0
    assert by_name["traffic light"] == 6
    assert by_name["bicycle"] == 18
    assert (by_name["garage"], by_name["gate"], by_name["smallpole"]) == (2, 4, 5)
    for void in ("unlabeled", "parking", "rail track", "guard rail", "caravan", "trailer", "lamp", "trash bin", "unknown object"):
        assert by_name[void] == 255
    assert labels.train_ids(np.array([-1, 7, 300])).tolist() == [255, 0, 255]
    train = np.arange(CLASS_COUNT, dtype=np.uint8)
    np.testing.assert_array_equal(labels.train_ids(labels.label_ids(train)), train)
    assert labels.label_ids(np.array([255], np.uint8)).tolist() == [0]


def test_frames_that_stood_have_no_pose_and_the_log_says_so(tmp_path: Path) -> None:
    root = write_drive(tmp_path, "kitti-360")
    file = find_sequence(root).poses / "cam0_to_world.txt"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:2] + lines[4:]) + "\n")
    log = open_log(root)
    assert log.truth is not None
    assert np.isnan(log.truth[2:4]).all()
    np.testing.assert_allclose(log.truth[[0, 1, 4, 5]], made_poses(FRAMES)[[0, 1, 4, 5]])
    assert "truth poses of 2 of 6 frames" in log.missing


def test_a_camera_that_was_turned_by_rectification_is_where_it_is_published(tmp_path: Path) -> None:
    root = write_drive(tmp_path, "kitti-360")
    sequence = find_sequence(root)
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.01, -0.02, 0.03]))
    file = sequence.calibration("perspective.txt")
    identity = " ".join(repr(float(v)) for v in np.eye(3).ravel())
    file.write_text(
        file.read_text().replace(f"R_rect_00: {identity}", "R_rect_00: " + " ".join(map(repr, turn[:3, :3].ravel().tolist())))
    )
    (sequence.poses / "cam0_to_world.txt").unlink()
    log = open_log(root)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth, made_poses(FRAMES) @ se3.inverse(turn), atol=1e-9)


def test_one_of_several_sequences_is_opened_by_its_folder(tmp_path: Path) -> None:
    root = write_drive(tmp_path, "kitti-360")
    first = find_sequence(root).name
    shutil.copytree(root / "data_2d_raw" / first, root / "data_2d_raw" / "other_sync")
    with pytest.raises(UnknownFormatError, match=rf"holds 2 sequences \({first}, other_sync\); give the folder of one"):
        open_log(root)
    other = open_log(root / "data_2d_raw" / "other_sync")
    assert (other.name, other.gnss, other.truth) == ("other_sync", None, None)
    assert open_log(root / "data_2d_raw" / first).truth is not None
    assert find_sequences(root) == find_sequences(tmp_path) == [Sequence(root, first), Sequence(root, "other_sync")]
    assert find_sequences(root / "data_2d_raw" / first) == [Sequence(root, first)]
    with pytest.raises(UnknownFormatError, match="no KITTI-360 data"):
        find_sequences(root / "calibration")


def test_published_names_of_cloud_properties_are_understood(tmp_path: Path) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int semantic\nproperty int instance\n"
        "property uchar visible\nproperty float confidence\nend_header\n"
    )
    row = np.zeros(1, np.dtype("<f4,<f4,<f4,u1,u1,u1,<i4,<i4,u1,<f4"))
    row[0] = (1352.5, 3821.25, 115.5, 10, 20, 30, 11, 11_042, 1, 0.75)
    file = tmp_path / "0000000002_0000000385.ply"
    file.write_bytes(header.encode() + row.tobytes())
    cloud = read_cloud(file)
    assert cloud.points.tolist() == [[1352.5, 3821.25, 115.5]]
    assert (cloud.semantic[0], cloud.instance[0], bool(cloud.visible[0]), cloud.confidence[0]) == (11, 11_042, True, 0.75)
    bare = header.replace("property int semantic\n", "property int other\n")
    file.write_bytes(bare.encode() + row.tobytes())
    with pytest.raises(LogError, match="has no labels"):
        read_cloud(file)


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda s: (s.images / "image_01" / "data_rect" / "0000000002.png").unlink(), LogError, "no partner"),
        (lambda s: s.calibration("perspective.txt").unlink(), CalibrationError, "no such file"),
        (lambda s: s.calibration("calib_cam_to_pose.txt").write_text("image_00: 1 2 3\n"), CalibrationError, "3 numbers where 12"),
        (lambda s: (s.poses / "cam0_to_world.txt").write_text("x 1 2\n"), LogError, "is no frame number"),
        (lambda s: (s.poses / "cam0_to_world.txt").write_text("0 " + "2 " * 16 + "\n"), LogError, "no rigid motion"),
        (lambda s: [f.unlink() for f in s.images.glob("*/timestamps.txt")], LogError, "get KITTI-360's time stamps"),
        (lambda s: shutil.rmtree(s.images), LogError, "holds no sequence"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(spoil: object, error: type[Exception], message: str, tmp_path: Path) -> None:
    root = write_drive(tmp_path, "kitti-360")
    spoil(find_sequence(root))  # type: ignore[operator]
    with pytest.raises(error, match=message) as told:
        open_log(root)
    assert "\n" not in str(told.value)


def test_images_of_another_size_than_the_calibration_are_refused(tmp_path: Path) -> None:
    root = write_drive(tmp_path, "kitti-360")
    for file in find_sequence(root).images.rglob("*.png"):
        cv2.imwrite(str(file), np.zeros((20, 32, 3), np.uint8))
    with pytest.raises(CalibrationError, match="images are 32x20, but the calibration is for 64x40"):
        open_log(root)


def test_the_calibration_is_read_by_kitti_360s_own_tools(written: tuple[Path, np.ndarray]) -> None:
    from kitti360scripts.devkits.commons.loadCalibration import (
        loadCalibrationCameraToPose,
        loadCalibrationRigid,
        loadPerspectiveIntrinsic,
    )

    folder = written[0] / "calibration"
    T_pose_cam = loadCalibrationCameraToPose(str(folder / "calib_cam_to_pose.txt"))
    assert [*T_pose_cam] == ["image_00", "image_01", "image_02", "image_03"]
    T_left_right = np.linalg.inv(T_pose_cam["image_00"]) @ T_pose_cam["image_01"]
    assert T_left_right[:3, 3] == pytest.approx(-np.array(RIG.t_right_left), abs=1e-9)
    intrinsics = loadPerspectiveIntrinsic(str(folder / "perspective.txt"))
    assert intrinsics["P_rect_00"][:3, :3] == pytest.approx(RIG.camera.K)
    assert loadCalibrationRigid(str(folder / "calib_cam_to_velo.txt")) == pytest.approx(np.linalg.inv(T_CAM_LIDAR))
