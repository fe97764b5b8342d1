"""Random damage to any file of a log ends in an InputError or in a log that can be read, never in anything else."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from logs.made_drives import sample_files, track_file, write_drive
from wayloom.errors import InputError
from wayloom.files.ply import read_ply, write_ply
from wayloom.files.trajectory_files import read_tum, write_tum
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.oxts import ins_trajectory

FILES = {
    "kitti-odometry": [
        "calib.txt", "times.txt", "poses.txt", "wayloom.json", "oxts/timestamps.txt", "oxts/data/0000000002.txt",
        "image_2/000000.png", "image_3/000003.png",
    ],
    "kitti-raw": [
        "calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt", "image_02/timestamps.txt",
        "oxts/timestamps.txt", "poses.txt", "image_03/data/0000000000.png",
    ],
    "kitti-csv": ["gnss.csv", "imu.csv", "exposure.csv"],
    "kitti-360": [
        "calibration/perspective.txt", "calibration/calib_cam_to_pose.txt", "data_2d_raw/made_2031_sync/image_00/timestamps.txt",
        "data_2d_raw/made_2031_sync/image_01/data_rect/0000000003.png", "data_poses/made_2031_sync/cam0_to_world.txt",
        "data_poses/made_2031_sync/oxts/data/0000000001.txt",
    ],
}  # fmt: skip
CASES = [(kind, name) for kind, names in FILES.items() for name in names]


@pytest.fixture(scope="module")
def drives() -> Iterator[dict[str, Path]]:
    """One drive of each kind, spoilt and mended in turn."""
    with tempfile.TemporaryDirectory() as folder:
        made = {kind: write_drive(Path(folder) / kind, kind) for kind in ("kitti-odometry", "kitti-raw", "kitti-360")}
        made["kitti-csv"] = write_drive(Path(folder) / "kitti-csv", "kitti-odometry", gnss=False)
        track_file(made["kitti-csv"] / "gnss.csv")
        sample_files(made["kitti-csv"])
        yield made


@st.composite
def damage(draw: st.DrawFn, data: bytes) -> bytes:
    """The bytes cut, with some changed, with a piece doubled, or with text put in."""
    spoilt = bytearray(data)
    kind = draw(st.sampled_from(["cut", "flip", "double", "insert", "drop line"]))
    at = draw(st.integers(0, max(0, len(spoilt) - 1)))
    if kind == "cut":
        del spoilt[at:]
    elif kind == "flip":
        for _ in range(draw(st.integers(1, 4))):
            place = draw(st.integers(0, len(spoilt) - 1))
            spoilt[place] = draw(st.integers(0, 255))
    elif kind == "double":
        spoilt[at:at] = spoilt[at : at + draw(st.integers(1, 200))]
    elif kind == "insert":
        words = [b"nan", b"-", b"1e308", b"1e-308", b"\x00", b"\n", b" 0 ", b"9" * 30, "\u0663".encode(), b"\xff", b"e", b"[", b'"']
        spoilt[at:at] = draw(st.sampled_from(words))
    else:
        lines = bytes(spoilt).split(b"\n")
        del lines[draw(st.integers(0, len(lines) - 1))]
        return b"\n".join(lines)
    return bytes(spoilt)


@pytest.mark.parametrize(("kind", "name"), CASES)
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.data())
def test_random_damage_never_ends_in_a_traceback(drives: dict[str, Path], kind: str, name: str, data: st.DataObject) -> None:
    file = drives[kind] / name
    whole = file.read_bytes()
    try:
        file.write_bytes(data.draw(damage(whole)))
        for use in (lambda: inspect_log(open_log(drives[kind])), lambda: ins_trajectory(drives[kind])):
            try:
                use()
            except InputError as problem:
                assert "\n" not in str(problem)  # noqa: PT017
    finally:
        file.write_bytes(whole)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_damaged_clouds_and_trajectories_never_end_in_a_traceback(data: st.DataObject) -> None:
    folder = Path(tempfile.mkdtemp())
    try:
        write_ply(folder / "c", np.zeros((4, 3)), np.zeros((4, 3), np.uint8), np.zeros(4, np.uint8))
        write_tum(folder / "t", np.arange(3), np.tile(np.eye(4), (3, 1, 1)))
        for name, read in (("c", read_ply), ("t", read_tum)):
            (folder / name).write_bytes(data.draw(damage((folder / name).read_bytes())))
            try:
                read(folder / name)
            except InputError as problem:
                assert "\n" not in str(problem)  # noqa: PT017
    finally:
        shutil.rmtree(folder)
