"""What a drive leaves of its rig: matches that are right, few, and the same each time; and the file that holds them."""

import io
import json
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from made_rig import LENS, RIG, LensLog
from made_street import curve, render

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.geometry.lens import IDENTITY, project_scaled
from wayloom.odometry.rig import calibration_observations as module
from wayloom.odometry.rig.calibration_file import is_observations_file, load_observations, save_observations
from wayloom.odometry.rig.calibration_observations import CalibrationObservations, ObservationCollector
from wayloom.odometry.rig.drive_name import drive_name
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.rig.rows import RightRectifier

LOG = LensLog(curve(9, 0.8, 0.01), lens=LENS)


def collected(log: LensLog = LOG, interrupted: int = -1) -> ObservationCollector:
    """Every frame of the log a keyframe at its true pose, with nothing known of the right camera."""
    collector, right = ObservationCollector(log.rig), RightRectifier(log.rig, IDENTITY, np.zeros(3))
    for frame in log.frames():
        if frame.index == interrupted:
            collector.interrupt()
        T_cam_world = se3.inverse(log.truth[frame.index])
        collector.on_keyframe(PosedPair(frame.index, frame.left, frame.right, T_cam_world, right, 0.0))
    return collector


@pytest.fixture(scope="module")
def drive() -> CalibrationObservations:
    return collected().observations(LOG)


def test_matches_lie_where_the_real_cameras_see_the_points(drive: CalibrationObservations) -> None:
    camera, t = RIG.camera, np.array(RIG.t_right_left)
    errors: dict[str, list[np.ndarray]] = {"right": [], "left target": [], "right target": []}
    for s, frame in enumerate(drive.host_frame):
        mine = drive.group == s
        uv = drive.uv_host[mine]
        rho = render(LOG.truth[frame], camera)[1][uv[:, 1], uv[:, 0]]
        rays = camera.rays(uv.astype(float))
        seen = project_scaled(LENS, camera, RIG.baseline_m, rays + rho[:, None] * t, rho)
        errors["right"].append(drive.uv_right[mine] - seen)
        for k, target in enumerate(drive.target_frame[s]):
            if target < 0:
                continue
            T = se3.inverse(LOG.truth[target]) @ LOG.truth[frame]
            q = rays @ T[:3, :3].T + rho[:, None] * T[:3, 3]
            errors["left target"].append(drive.uv_left_target[mine, k] - camera.project(q))
            seen = project_scaled(LENS, camera, RIG.baseline_m, q + rho[:, None] * t, rho)
            errors["right target"].append(drive.uv_right_target[mine, k] - seen)
    for found in errors.values():
        error = np.concatenate(found)
        error = error[np.isfinite(error[:, 0])]
        assert len(error) > 50
        assert np.abs(np.median(error, axis=0)).max() < 0.03
        assert np.median(np.abs(error)) < 0.1


def test_a_match_groups_targets_are_the_first_keyframes_far_enough(drive: CalibrationObservations) -> None:
    assert drive.host_frame[0] == 0
    assert drive.target_frame[0].tolist() == [2, 4]  # 1.0 and 2.5 m at 0.8 m a frame
    T = se3.inverse(LOG.truth[2]) @ LOG.truth[0]
    np.testing.assert_allclose(drive.T_target_host[0, 0], T, atol=1e-9)
    assert np.diff(drive.group).min() >= 0
    assert np.bincount(drive.group).max() <= module.MOST_POINTS


def test_the_same_drive_leaves_the_same_bytes(drive: CalibrationObservations, tmp_path: Path) -> None:
    save_observations(drive, tmp_path / "one.npz")
    save_observations(collected().observations(LOG), tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_a_lost_drive_closes_no_match_group_across_the_gap() -> None:
    frames = collected(interrupted=1).observations(LOG)
    assert frames.host_frame[0] == 1


def test_a_car_that_stands_leaves_nothing() -> None:
    log = LensLog(np.tile(np.eye(4), (4, 1, 1)))
    still = collected(log).observations(log)
    assert (still.groups, len(still)) == (0, 0)
    assert still.uv_left_target.shape == (0, module.TARGETS, 2)


def test_a_long_drive_keeps_a_bounded_number_of_match_groups_spread_over_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_GROUPS", 2)
    monkeypatch.setattr(module, "SPACING_M", 0.5)
    log = LensLog(curve(16, 0.8, 0.0), lens=LENS)
    found = collected(log)
    assert len(found.finished) <= 2
    assert found.stride > 1
    assert found.finished[0].frame == 0


def test_drives_of_one_name_are_told_apart_by_their_times() -> None:
    assert drive_name(LOG).startswith("made#")
    assert drive_name(LOG) == drive_name(LensLog(curve(9)))
    assert drive_name(LOG) != drive_name(LensLog(curve(8)))


def test_an_evidence_file_comes_back_as_it_was_written(drive: CalibrationObservations, tmp_path: Path) -> None:
    file = tmp_path / "evidence.npz"
    save_observations(drive, file)
    again = load_observations(file)
    for field in fields(CalibrationObservations):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(drive, field.name))
    assert is_observations_file(file)
    assert not is_observations_file(tmp_path)
    assert not is_observations_file(Path(__file__))


def rewritten(file: Path, name: str, content: bytes) -> None:
    with zipfile.ZipFile(file) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members[name] = content
    with zipfile.ZipFile(file, "w") as archive:
        for member, data in members.items():
            archive.writestr(member, data)


def array_bytes(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("meta.json", json.dumps({"format": "wayloom-evidence", "version": 9}).encode(), "version 9"),
        ("meta.json", b"[]", "holds no calibration observations"),
        ("uv_host.npy", b"cut", "holds no calibration observations"),
        ("uv_host.npy", array_bytes(np.zeros((3, 2), np.int32)), "shape"),
        ("uv_right.npy", array_bytes(np.zeros((3, 2))), "holds no calibration observations"),
        ("snippet.npy", array_bytes(np.array([5, 1, 0], np.int32)), "shape"),
    ],
)
def test_a_damaged_evidence_file_is_refused(
    drive: CalibrationObservations, name: str, content: bytes, says: str, tmp_path: Path
) -> None:
    file = tmp_path / "evidence.npz"
    save_observations(drive, file)
    rewritten(file, name, content)
    with pytest.raises(InputError, match=says) as raised:
        load_observations(file)
    assert str(file) in str(raised.value)


def test_an_evidence_file_with_impossible_values_is_refused(drive: CalibrationObservations, tmp_path: Path) -> None:
    for bad in (
        replace(drive, uv_right=np.full_like(drive.uv_right, np.nan)),
        replace(drive, uv_host=drive.uv_host + 10_000),
        replace(drive, group=drive.group[::-1].copy() + 3),
    ):
        save_observations(bad, tmp_path / "bad.npz")
        with pytest.raises(InputError, match="cannot be"):
            load_observations(tmp_path / "bad.npz")
