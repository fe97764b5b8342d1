"""Logs that somebody made to do harm: each is refused quickly, with a code, and in bounded memory."""

import os
import random
import socket
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from logs.made_drives import write_drive
from logs.spoiling import made_logs, read_all, spoilt
from wayloom.errors import InputError
from wayloom.logs.registry import open_log

KINDS = (
    "kitti-odometry", "kitti-raw", "kitti-360", "euroc", "mcap", "kitti-odometry-tables", "euroc-tables", "foxglove-protobuf",
    "foxglove-json",
)  # fmt: skip


@pytest.fixture(scope="module")
def logs() -> Iterator[dict[str, Path]]:
    with tempfile.TemporaryDirectory() as folder:
        yield made_logs(Path(folder))


def test_every_made_log_is_read_as_long_as_nobody_spoils_it(logs: dict[str, Path]) -> None:
    assert tuple(logs) == KINDS
    assert {read_all(drive) for drive in logs.values()} == {"read"}


@pytest.mark.parametrize("kind", KINDS)
@settings(
    max_examples=12,
    deadline=timedelta(seconds=20),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(seed=st.integers(0, 2**32))
def test_a_log_with_any_file_damaged_is_read_or_refused_with_a_code(logs: dict[str, Path], kind: str, seed: int) -> None:
    dice = random.Random(seed)
    file = dice.choice(sorted(file for file in logs[kind].rglob("*") if file.is_file()))
    whole = file.read_bytes()
    try:
        file.write_bytes(spoilt(whole, dice))
        read_all(logs[kind])
    finally:
        file.write_bytes(whole)


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def listening(path: Path) -> None:
    """A socket, bound by a short name: its path may have 107 bytes only."""
    path.unlink()
    here = Path.cwd()
    with socket.socket(socket.AF_UNIX) as bound:
        os.chdir(path.parent)
        try:
            bound.bind(path.name)
        finally:
            os.chdir(here)


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("make", [fifo, device, listening, folder])
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("kitti-odometry", "times.txt"), ("kitti-odometry", "calib.txt"), ("kitti-odometry", "wayloom.json"),
        ("kitti-odometry", "image_2/000002.png"), ("euroc", "mav0/cam0/data.csv"), ("euroc", "mav0/cam1/sensor.yaml"),
    ],
)  # fmt: skip
def test_what_is_no_file_is_refused_by_name_without_waiting(
    tmp_path: Path, kind: str, name: str, make: Callable[[Path], None]
) -> None:
    drive = write_drive(tmp_path, kind)
    make(drive / name)
    began = time.monotonic()
    with pytest.raises(InputError) as refused:
        open_log(drive)
    assert time.monotonic() - began < 5.0
    assert Path(name).name in str(refused.value)
    assert refused.value.reason in ("file.irregular", "file.outside")


@pytest.mark.parametrize("kind", ["kitti-odometry", "kitti-raw", "kitti-360", "euroc"])
def test_links_that_lead_out_of_the_log_are_refused_and_those_within_it_are_not(tmp_path: Path, kind: str) -> None:
    drive = write_drive(tmp_path / "log", kind)
    images = sorted(file for file in drive.rglob("*.png"))
    inside = images[1].with_name("twin.bin")
    images[1].rename(inside)
    images[1].symlink_to(inside.name)
    assert len(open_log(drive)) == 6
    outside = tmp_path / "secret.png"
    images[2].rename(outside)
    images[2].symlink_to(outside)
    with pytest.raises(InputError, match="symbolic link that leads out of") as refused:
        open_log(drive)
    assert refused.value.reason == "file.outside"
    images[2].unlink()
    outside.rename(images[2])
    images[2].parent.rename(tmp_path / "elsewhere")
    images[2].parent.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="symbolic link that leads out of"):
        open_log(drive)


def test_a_log_that_is_a_link_itself_is_read(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "there", "euroc")
    (tmp_path / "here").symlink_to(drive)
    assert len(open_log(tmp_path / "here")) == 6


BOMBS = {
    "nested JSON": ("kitti-odometry", "wayloom.json", b"[" * 200_000 + b"]" * 200_000),
    "wide JSON": ("kitti-odometry", "wayloom.json", b'{"rig_id": "' + b"x" * 5_000_000 + b'"}'),
    "aliases of aliases": (
        "euroc",
        "mav0/cam0/sensor.yaml",
        b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(b"b%d: &b%d [*a,*a,*a,*a,*a]\n" % (i, i) for i in range(500)),
    ),
    "a list that never ends": ("euroc", "mav0/cam0/sensor.yaml", b"T_BS:\n  data: [" + b"1, " * 300_000),
    "a key without end": ("euroc", "mav0/cam0/sensor.yaml", b"a" * 900_000),
    "spaces": ("euroc", "mav0/cam0/sensor.yaml", b"a " * 400_000 + b"\n"),
    "digits": ("euroc", "mav0/cam0/data.csv", b"9" * 60_000 + b",x.png\n"),
    "fields": ("euroc", "mav0/imu0/data.csv", b"x," * 30_000 + b"\n"),
    "exponents": ("kitti-odometry", "times.txt", b"1e999999999\n" * 6),
    "long digits": ("kitti-odometry", "times.txt", b"1" * 60_000 + b"\n"),
    "quotes": ("kitti-odometry-gnss", "gnss.csv", b't_ns,lon_deg,"' + b"\n" * 200_000),
}


@pytest.mark.parametrize("case", sorted(BOMBS))
def test_small_files_that_want_to_be_large_are_refused_in_time_and_memory(tmp_path: Path, case: str) -> None:
    kind, name, data = BOMBS[case]
    drive = write_drive(tmp_path, kind.removesuffix("-gnss"), gnss=not kind.endswith("-gnss"))
    if name.startswith("mav0/imu0"):
        (drive / "mav0/imu0").mkdir()
    (drive / name).write_bytes(data)
    began = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as refused:
            open_log(drive)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < 5.0
    assert most < 40 * len(data) + (4 << 20)
    assert len(str(refused.value)) < 1000
