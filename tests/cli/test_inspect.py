"""`wayloom inspect`, as a process."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from logs.made_drives import write_drive


def wayloom(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command line as a user would."""
    command = [sys.executable, "-m", "wayloom.cli.main", *(str(argument) for argument in arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_it_prints_what_is_in_a_log_in_words_or_as_json(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives", "kitti-raw")
    done = wayloom("inspect", drive)
    assert (done.returncode, done.stderr) == (0, "")
    for words in (
        "kitti-raw",
        "6 at 10.00 Hz, 0.70 s, 1 gap: 0.30 s after 4",
        "5.0 m (from truth)",
        "64x40, colour",
        "fixed 33 %",
    ):
        assert words in done.stdout
    report = json.loads(wayloom("inspect", drive, "--json").stdout)
    assert report["usable"] is True
    assert report["camera"]["baseline_m"] == 0.5


def test_it_takes_gnss_from_elsewhere(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "a", "kitti-odometry", gnss=False)
    lender = write_drive(tmp_path / "b", "kitti-raw")
    assert "GNSS place" not in wayloom("inspect", drive).stdout
    done = wayloom("inspect", drive, "--gnss", lender, "--quick")
    assert done.returncode == 0
    assert "48.980000, 8.390000 (lat, lon)" in done.stdout


def test_damaged_images_are_listed_and_the_status_is_2(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    for number in (1, 3):
        file = drive / "image_3" / f"{number:06d}.png"
        file.write_bytes(file.read_bytes()[:700])
    done = wayloom("inspect", drive)
    assert done.returncode == 2
    assert done.stdout.count("damaged: ") == 2
    assert done.stderr.startswith("wayloom: 2 of 12 images cannot be used, the first: ")
    assert done.stderr.count("\n") == 1
    assert "image_3/000001.png: the image is truncated" in done.stderr
    told = wayloom("inspect", drive, "--json")
    assert (told.returncode, told.stderr) == (2, done.stderr)
    assert json.loads(told.stdout)["usable"] is False


def test_a_link_that_leads_nowhere_is_a_damaged_image(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    (drive / "image_3" / "000002.png").unlink()
    (drive / "image_3" / "000002.png").symlink_to("nowhere.png")
    done = wayloom("inspect", drive)
    assert done.returncode == 2
    assert "image_3/000002.png: cannot be read (No such file or directory)" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_decoder_that_fails_adds_no_line_of_its_own(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    (drive / "image_3" / "000002.png").unlink()
    (drive / "image_3" / "000002.pgm").write_bytes(b"P5 64 40 255\n" + bytes(1000))
    done = wayloom("inspect", drive)
    assert done.returncode == 2
    assert "image_3/000002.pgm: not an image that can be decoded" in done.stderr
    assert done.stderr.count("\n") == 1


def spoil_times(drive: Path) -> None:
    lines = (drive / "times.txt").read_text().splitlines()
    (drive / "times.txt").write_text("\n".join([*lines[:3], lines[1], *lines[4:]]) + "\n")


BAD_LOGS = {
    "missing calibration": (lambda drive: (drive / "calib.txt").unlink(), "calib.txt: no such file; copy the calibration"),
    "counts that differ": (lambda drive: (drive / "image_3/000005.png").unlink(), "image_2/000005.png: no partner in"),
    "time stamp going back": (spoil_times, "times.txt, line 4: time stamp goes back by 0.1"),
    "a picture of another size": (
        lambda drive: cv2.imwrite(str(drive / "image_2/000002.png"), cv2.imread(str(drive / "image_2/000002.png"))[:30]),
        "image_2/000002.png: the image is 64x30",
    ),
}


@pytest.mark.parametrize("what", list(BAD_LOGS))
def test_a_log_that_cannot_be_used_ends_in_one_line_and_status_2(tmp_path: Path, what: str) -> None:
    spoil, said = BAD_LOGS[what]
    drive = write_drive(tmp_path / "drives", "kitti-odometry")
    spoil(drive)
    done = wayloom("inspect", drive)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


def test_an_empty_folder_an_unknown_one_and_none_end_in_status_2_and_print_no_document(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("x")
    for folder, said in (("empty", "the folder is empty; known are"), ("other", "no known log format"), ("none", "no such folder")):
        done = wayloom("inspect", tmp_path / folder, "--json")
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith(f"wayloom: {tmp_path / folder}: ")
        assert said in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.real_data
def test_the_real_clips_are_usable(clip_a: Path, clip_a_gnss: Path, clip_b: Path) -> None:
    a = wayloom("inspect", clip_a, "--gnss", clip_a_gnss)
    assert a.returncode == 0
    for words in ("201 at 9.65 Hz, 20.73 s, no gaps", "145.4 m (from truth)", "1241x376, grey", "fixed 49 %", "0.5372 m"):
        assert words in a.stdout
    b = wayloom("inspect", clip_b)
    assert b.returncode == 0
    for words in ("154 at 9.68 Hz, 15.80 s", "1242x375, colour", "2011-09-26 13:04:32.345808896", "-0.254, 0.719, -1.086 m"):
        assert words in b.stdout
