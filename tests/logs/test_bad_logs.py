"""Whatever is wrong with a log ends in one line that names the file, the record and the remedy."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from logs.made_drives import write_drive
from wayloom.errors import CalibrationError, InputError, LogError, UnknownFormatError
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.logs.registry import open_log

Spoil = Callable[[Path], object]


def replace(name: str, old: str, new: str) -> Spoil:
    def spoil(drive: Path) -> None:
        text = (drive / name).read_text()
        assert old in text
        (drive / name).write_text(text.replace(old, new, 1))

    return spoil


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Spoil:
    return lambda drive: (drive / name).write_text("\n".join(change((drive / name).read_text().splitlines())) + "\n")


def cut(name: str, keep: float) -> Spoil:
    def spoil(drive: Path) -> None:
        data = (drive / name).read_bytes()
        (drive / name).write_bytes(data[: int(len(data) * keep)])

    return spoil


def picture(name: str, width: int, height: int) -> Spoil:
    return lambda drive: cv2.imwrite(str(drive / name), np.zeros((height, width, 3), np.uint8))


def jpeg(name: str, keep: float) -> Spoil:
    def spoil(drive: Path) -> None:
        (drive / name).unlink()
        data = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 256, (40, 64, 3), dtype=np.uint8))[1].tobytes()
        (drive / name).with_suffix(".jpg").write_bytes(data[: int(len(data) * keep)])

    return spoil


def baseline(drive: Path, metres: float) -> None:
    """P3 of a camera that far to the right of that of P2."""
    rows = (drive / "calib.txt").read_text().splitlines()
    words = rows[2].split()[1:]
    words[3] = repr(float(words[3]) - metres * float(words[0]))
    (drive / "calib.txt").write_text("\n".join([*rows[:3], f"P3: {' '.join(words)}"]) + "\n")


def remove(name: str) -> Spoil:
    return lambda drive: (drive / name).unlink()


ODOMETRY: dict[str, tuple[Spoil, type[InputError], tuple[str, ...]]] = {
    "missing calibration": (remove("calib.txt"), CalibrationError, ("calib.txt", "no such file", "copy the calibration")),
    "missing key": (replace("calib.txt", "P3", "Q3"), CalibrationError, ("calib.txt, P3", "is missing")),
    "word": (replace("calib.txt", "P2: 101.5", "P2: 1o1.5"), CalibrationError, ("calib.txt, P2, line 3: '1o1.5' is not a number",)),
    "split number": (
        replace("calib.txt", "P3: 101.5", "P3: 101. 5e+"),
        CalibrationError,
        ("calib.txt, P3, line 4: 13 numbers where 12 belong, and '5e+' is not a number; the line is cut or damaged",),
    ),
    "long word": (
        replace("calib.txt", "P2: 101.5", f"P2: {50 * 'x'}"),
        CalibrationError,
        (f"calib.txt, P2, line 3: '{40 * 'x'}…' is not a number; correct the file",),
    ),
    "not finite": (replace("calib.txt", "P2: 101.5", "P2: nan"), CalibrationError, ("calib.txt, P2", "not finite")),
    "short": (replace("calib.txt", "P2: 101.5", "P2:"), CalibrationError, ("calib.txt, P2", "11 numbers where 12 belong")),
    "focal length": (replace("calib.txt", "P2: 101.5", "P2: -1"), CalibrationError, ("calib.txt, P2", "focal length -1")),
    "different focal lengths": (replace("calib.txt", "P2: 101.5", "P2: 99.0"), CalibrationError, ("calib.txt", "P2 and P3")),
    "no baseline": (
        lines("calib.txt", lambda rows: [*rows[:3], rows[2].replace("P2", "P3")]),
        CalibrationError,
        ("calib.txt, P3", "baseline -0.0000 m is not positive"),
    ),
    "baseline in mm": (
        lambda drive: baseline(drive, 540.0),
        CalibrationError,
        ("calib.txt, P3", "baseline of 540 m is impossible"),
    ),
    "baseline of an atom": (lambda drive: baseline(drive, 1e-9), CalibrationError, ("calib.txt, P3", "baseline of 1e-09 m")),
    "no projection": (replace("calib.txt", "P2: 101.5 0.0", "P2: 101.5 5.0"), CalibrationError, ("calib.txt, P2", "no projection")),
    "other camera": (
        lambda drive: [picture(f"image_{c}/{i:06d}.png", 20, 16)(drive) for c in (2, 3) for i in range(6)],
        CalibrationError,
        ("calib.txt, P2", "outside of the 20x16 images"),
    ),
    "binary": (lambda drive: (drive / "calib.txt").write_bytes(b"P0: \xff\xfe"), CalibrationError, ("calib.txt", "not UTF-8")),
    "truncated PNG": (cut("image_2/000002.png", 0.6), LogError, ("image_2/000002.png", "truncated", "copy the file again")),
    "empty PNG": (cut("image_3/000000.png", 0.0), LogError, ("image_3/000000.png", "empty (0 bytes)")),
    "empty first PNG": (cut("image_2/000000.png", 0.0), LogError, ("image_2/000000.png", "empty (0 bytes)")),
    "stub of a PNG": (cut("image_2/000000.png", 0.002), LogError, ("image_2/000000.png", "truncated")),
    "truncated JPEG": (jpeg("image_2/000001.png", 0.7), LogError, ("image_2/000001.jpg", "truncated")),
    "no image": (lambda drive: (drive / "image_2/000001.png").write_text("hello"), LogError, ("000001.png", "not an image")),
    "other size": (picture("image_2/000003.png", 64, 41), LogError, ("image_2/000003.png", "64x41", "64x40")),
    "sizes of the sides": (
        lambda drive: [picture(f"image_3/{i:06d}.png", 62, 40)(drive) for i in range(6)],
        LogError,
        ("image_3/000000.png", "62x40", "64x40"),
    ),
    "left only": (remove("image_3/000004.png"), LogError, ("image_2/000004.png", "no partner", "6 left and 5 right", "add the")),
    "right only": (remove("image_2/000001.png"), LogError, ("image_3/000001.png", "no partner", "5 left and 6 right")),
    "no right folder": (lambda drive: shutil.rmtree(drive / "image_3"), LogError, ("image_3", "no such folder")),
    "no images": (
        lambda drive: [file.unlink() for file in drive.glob("image_?/*")],
        LogError,
        ("image_2", "no images", "put images there"),
    ),
    "two of a name": (
        lambda drive: (drive / "image_2/000001.jpg").write_bytes(b"x"),
        LogError,
        ("image_2/000001.png", "a second image", "000001.jpg"),
    ),
    "missing times": (remove("times.txt"), LogError, ("times.txt", "no such file", "one time stamp")),
    "few times": (lines("times.txt", lambda rows: rows[:4]), LogError, ("times.txt", "4 time stamps for 6 frames")),
    "time goes back": (
        lines("times.txt", lambda rows: [*rows[:3], rows[1], *rows[4:]]),
        LogError,
        ("times.txt, line 4", "goes back by 0.1"),
    ),
    "time repeats": (lines("times.txt", lambda rows: [rows[0], *rows[:5]]), LogError, ("times.txt, line 2", "repeats")),
    "no time": (lines("times.txt", lambda rows: [*rows[:2], "noon", *rows[3:]]), LogError, ("times.txt, line 3", "'noon'")),
    "endless time": (lines("times.txt", lambda rows: [*rows[:5], "1e999"]), LogError, ("times.txt, line 6", "no possible time")),
    "few poses": (lines("poses.txt", lambda rows: rows[:5]), LogError, ("poses.txt", "5 poses for 6 frames")),
    "bent pose": (lines("poses.txt", lambda rows: ["2 " + rows[0][12:], *rows[1:]]), LogError, ("poses.txt, line 1",)),
    "short packet": (cut("oxts/data/0000000003.txt", 0.5), LogError, ("0000000003.txt, line 1", "where 30 belong")),
    "no place": (replace("oxts/data/0000000002.txt", "48.98", "148.98"), LogError, ("0000000002.txt", "148.98", "no place")),
    "few packets' times": (lines("oxts/timestamps.txt", lambda rows: rows[:3]), LogError, ("oxts/timestamps.txt", "3 time stamps")),
    "GNSS time goes back": (
        lines("oxts/timestamps.txt", lambda rows: [rows[1], rows[0], *rows[2:]]),
        LogError,
        ("oxts/timestamps.txt, line 2", "goes back"),
    ),
    "no packets": (
        lambda drive: [file.unlink() for file in (drive / "oxts/data").iterdir()],
        LogError,
        ("oxts/data", "no GNSS packets"),
    ),
    "strange sidecar": (replace("wayloom.json", '"rig_id"', '"rig"'), LogError, ("wayloom.json, rig", "docs/formats.md")),
    "bent sidecar": (replace("wayloom.json", "-1.0", "-1.2"), LogError, ("wayloom.json, T_cam_imu", "no rigid motion")),
    "no JSON": (lambda drive: (drive / "wayloom.json").write_text("{"), LogError, ("wayloom.json", "Invalid JSON")),
}

RAW: dict[str, tuple[Spoil, type[InputError], tuple[str, ...]]] = {
    "missing calibration": (
        remove("calib_cam_to_cam.txt"),
        CalibrationError,
        ("calib_cam_to_cam.txt", "no such file", "copy KITTI"),
    ),
    "missing key": (replace("calib_cam_to_cam.txt", "P_rect_03", "X"), CalibrationError, ("calib_cam_to_cam.txt, P_rect_03",)),
    "other size": (
        lambda drive: [replace("calib_cam_to_cam.txt", f"{key}_02: 64 40", f"{key}_02: 65 40")(drive) for key in ("S", "S_rect")],
        CalibrationError,
        ("calib_cam_to_cam.txt", "images are 64x40", "65x40"),
    ),
    "bent rotation": (
        replace("calib_velo_to_cam.txt", "-1.0", "-1.5"),
        CalibrationError,
        ("calib_velo_to_cam.txt, R", "no rotation"),
    ),
    "left only": (remove("image_03/data/0000000002.png"), LogError, ("image_02/data/0000000002.png", "no partner")),
    "no times": (
        lambda drive: [remove(f"image_{c}/timestamps.txt")(drive) for c in ("02", "03")],
        LogError,
        ("image_02/timestamps.txt", "no such file", "at least one of the two cameras"),
    ),
    "time goes back": (
        lines("image_02/timestamps.txt", lambda rows: [*rows[:4], rows[0], rows[5]]),
        LogError,
        ("image_02/timestamps.txt, line 5", "goes back by 0.3"),
    ),
    "no day": (
        replace("image_02/timestamps.txt", "2011-09-26", "2011-02-31"),
        LogError,
        ("image_02/timestamps.txt, line 1", "no day of the calendar"),
    ),
    "no clock": (replace("image_02/timestamps.txt", "2011-09-26", "26.9.2011"), LogError, ("line 1", "is not a time like")),
    "truncated PNG": (cut("image_03/data/0000000005.png", 0.5), LogError, ("image_03/data/0000000005.png", "truncated")),
}
CASES = [("kitti-odometry", case) for case in ODOMETRY] + [("kitti-raw", case) for case in RAW]


@pytest.mark.parametrize(("log_format", "case"), CASES)
def test_a_spoilt_log_is_refused_with_one_clear_line(tmp_path: Path, log_format: str, case: str) -> None:
    spoil, error, words = (ODOMETRY if log_format == "kitti-odometry" else RAW)[case]
    drive = write_drive(tmp_path, log_format)
    spoil(drive)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(error) as caught:
        open_log(drive)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message
    assert sorted(tmp_path.rglob("*")) == before, "reading leaves nothing behind"


def test_a_damaged_picture_is_found_when_it_is_read(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    file = drive / "image_2/000001.png"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(data)
    log = open_log(drive)
    log.frame(0)
    with pytest.raises(LogError, match=r"image_2/000001.png, byte \d+: the image is damaged: wrong check sum"):
        log.frame(1)


def test_a_picture_that_vanishes_after_opening_is_named(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    log = open_log(drive)
    (drive / "image_3/000002.png").unlink()
    with pytest.raises(LogError, match=r"image_3/000002.png: no such file"):
        log.frame(2)


def test_an_empty_folder_lists_what_is_known(tmp_path: Path) -> None:
    with pytest.raises(
        UnknownFormatError, match=r"the folder is empty; known are kitti-360 .*kitti-odometry \(image_0.*kitti-raw \(image_00"
    ):
        open_log(tmp_path)


def test_an_unknown_format_lists_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(UnknownFormatError, match=r"no known log format; known are .*calib\.txt and times\.txt"):
        open_log(tmp_path)


def test_a_file_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "drive.bag").write_text("x")
    with pytest.raises(UnknownFormatError, match=r"drive\.bag: is a file; known are"):
        open_log(tmp_path / "drive.bag")


def test_a_path_that_does_not_exist_is_said(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nowhere: no such folder; give the path"):
        open_log(tmp_path / "nowhere")


def test_a_gnss_drive_without_images_says_how_it_is_used(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw")
    for camera in ("02", "03"):
        shutil.rmtree(drive / f"image_{camera}")
    with pytest.raises(LogError, match=r"no image folders, GNSS only; .*--gnss"):
        open_log(drive)


@pytest.mark.parametrize("name", ["", "image_2", "calib.txt", "image_2/000001.png"])
def test_what_may_not_be_read_is_named_with_its_permissions(tmp_path: Path, name: str) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == os.geteuid() and not folder.stat().st_mode & 0o001:
            folder.chmod(folder.stat().st_mode | 0o111)
    (drive / name).chmod(0)
    with as_another_user(), pytest.raises(InputError) as caught:
        open_log(drive)
    (drive / name).chmod(0o755)
    assert str(caught.value).startswith(f"{drive / name}: ")
    assert "Permission denied" in str(caught.value)


@contextmanager
def as_another_user() -> Iterator[None]:
    """Root may read everything: where the tests run as root, be nobody for a while."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def test_the_first_spoilt_record_is_named_with_its_time(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw")
    stamps = drive / "image_02/timestamps.txt"
    stamps.write_text(stamps.read_text() + wall_clock_from_ns(0) + "\n")
    assert len(open_log(drive)) == 6, "a line more than images, as where a clip was cut"
