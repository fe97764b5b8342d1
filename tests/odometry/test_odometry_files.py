import hashlib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from made_street import MadeLog, curve

from wayloom.errors import InputError
from wayloom.odometry.odometry import track
from wayloom.odometry.result.odometry_file import load_odometry, observations_stored, save_odometry
from wayloom.odometry.types import OdometryResult, Points


@pytest.fixture(scope="module")
def result() -> OdometryResult:
    return track(MadeLog(curve(8)))


def test_a_result_comes_back_as_it_was_stored(result: OdometryResult, tmp_path: Path) -> None:
    save_odometry(result, tmp_path / "a.npz")
    again = load_odometry(tmp_path / "a.npz")
    for group in ("trajectory", "keyframes", "points"):
        for name in type(getattr(result, group)).__slots__:
            a, b = getattr(getattr(result, group), name), getattr(getattr(again, group), name)
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
    assert again.rig == result.rig
    assert again.disparity_bias_px == result.disparity_bias_px
    np.testing.assert_array_equal(again.row_coefficients, result.row_coefficients)
    assert again.report == {key: value for key, value in result.report.items() if key != "seconds"}


def test_observations_are_counted_without_a_point_being_read(result: OdometryResult, tmp_path: Path) -> None:
    save_odometry(result, tmp_path / "a.npz")
    assert observations_stored(tmp_path / "a.npz") == len(result.points.obs_keyframe) > 100
    (tmp_path / "bad.npz").write_bytes(b"no zip")
    for name in ("bad.npz", "none.npz"):
        with pytest.raises(InputError, match=name):
            observations_stored(tmp_path / name)


def test_equal_results_give_equal_bytes(result: OdometryResult, tmp_path: Path) -> None:
    digests = set()
    for name, other in (("a", result), ("b", track(MadeLog(curve(8)), threads=2))):
        save_odometry(other, tmp_path / name)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_file_of_version_1_is_read_without_covariances_of_steps(result: OdometryResult, tmp_path: Path) -> None:
    save_odometry(result, tmp_path / "new.npz")
    with zipfile.ZipFile(tmp_path / "new.npz") as new, zipfile.ZipFile(tmp_path / "old.npz", "w") as old:
        for name in new.namelist():
            content = new.read(name).replace(b'"version": 2', b'"version": 1')
            if name != "keyframes.step_covariance.npy":
                old.writestr(name, content)
    again = load_odometry(tmp_path / "old.npz")
    np.testing.assert_array_equal(again.keyframes.T_world_cam, result.keyframes.T_world_cam)
    assert np.isnan(again.keyframes.step_covariance).all()


def test_numpy_opens_the_file_too(result: OdometryResult, tmp_path: Path) -> None:
    save_odometry(result, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        np.testing.assert_array_equal(arrays["points.host"], result.points.host)


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x03\x04 cut"])
def test_what_is_no_result_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.npz"):
        load_odometry(tmp_path / "bad.npz")


def test_a_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.npz"):
        load_odometry(tmp_path / "none.npz")


def test_another_version_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "old.npz", "w") as archive:
        archive.writestr("meta.json", '{"format": "wayloom-odometry", "version": 99}')
    with pytest.raises(InputError, match="version 99"):
        load_odometry(tmp_path / "old.npz")


def test_points_of_some_rows_lie_where_they_do_among_all(result: OdometryResult, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, rows = result.points_world(), np.arange(len(result.points))[::-3]
    assert len(rows) > 100
    monkeypatch.setattr("wayloom.odometry.types.POINTS_AT_ONCE", 64)
    np.testing.assert_array_equal(result.points_world(), whole)
    np.testing.assert_array_equal(result.points_world(rows), whole[rows])
    assert result.points_world(rows[:0]).shape == (0, 3)


def test_of_a_long_drive_no_more_is_read_than_is_wanted(result: OdometryResult, tmp_path: Path) -> None:
    save_odometry(result, tmp_path / "odometry.npz")
    points, way = (load_odometry(tmp_path / "odometry.npz", wanted) for wanted in ("points", "way"))
    np.testing.assert_array_equal(points.points_world(), result.points_world())
    assert points.points.obs_start.tolist() == [0] * (len(result.points) + 1)
    assert len(points.points.obs_keyframe) == len(points.points.obs_right) == 0
    assert len(result.points.obs_keyframe) > 0
    assert len(way.points) == 0
    for name in Points.__slots__:
        none, some = getattr(way.points, name), getattr(result.points, name)
        assert (none.dtype, none.shape[1:]) == (some.dtype, some.shape[1:]), name
    for part in (points, way):
        np.testing.assert_array_equal(part.keyframes.T_world_cam, result.keyframes.T_world_cam)
        np.testing.assert_array_equal(part.trajectory.t_ns, result.trajectory.t_ns)
        assert part.rig == result.rig
