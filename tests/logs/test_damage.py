"""Frames whose images are damaged are left out of a drive, as long as they are few, and told with a code."""

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from logs.made_drives import WRITERS, made_frames, made_poses, write_drive
from wayloom.client.manifests import pack
from wayloom.errors import InputError, LogError
from wayloom.logs.damage import MOST_DAMAGED, without_damage, without_frames
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import open_log, open_log_unchecked
from wayloom.logs.types import StoredLog
from wayloom.pipeline import log_source
from wayloom.pipeline.log_parts import FORMAT_VERSION, LOG_FILE, read_log_file, rejected_frames
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages import ingest

COUNT = 24


@pytest.mark.parametrize("log_format", list(WRITERS))
def test_a_log_without_some_frames_keeps_everything_else_in_step(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path, log_format, count=COUNT))
    kept = without_frames(log, {3: LogError("x", file="a.png", reason="image.empty"), 17: LogError("y", file="b.png")})
    rows = [row for row in range(COUNT) if row not in (3, 17)]
    frames = made_frames(COUNT, True)
    assert kept.t_ns.tolist() == [frames[row].t_ns for row in rows]
    assert kept.truth is not None
    np.testing.assert_allclose(kept.truth, made_poses(COUNT)[rows], atol=1e-8)
    for index, row in ((2, 2), (3, 4), (21, 23)):
        frame = kept.frame(index)
        assert (frame.index, frame.t_ns) == (index, frames[row].t_ns)
        np.testing.assert_array_equal(frame.left, frames[row].left)
        np.testing.assert_array_equal(frame.right, frames[row].right)
    assert kept.missing[-1] == "frames that were left out: 3 (image.empty, a.png), 17 (log.invalid, b.png)"
    assert kept.files == log.files


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-20])


def unpackable(file: Path) -> None:
    """A PNG whose check sums are right and whose pixels cannot be unpacked."""
    data = file.read_bytes()
    at = data.index(b"IDAT")
    length = int.from_bytes(data[at - 4 : at], "big")
    body = data[at : at + 4] + b"\xff" * length
    file.write_bytes(data[:at] + body + zlib.crc32(body).to_bytes(4, "big") + data[at + 4 + length + 4 :])


@pytest.mark.parametrize(
    ("name", "frame", "reason"),
    [("image_2/000000.png", 0, "image.truncated"), ("image_3/000011.png", 11, "image.truncated")],
)
def test_an_image_that_is_cut_costs_its_frame(tmp_path: Path, name: str, frame: int, reason: str) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", count=COUNT)
    cut(drive / name)
    with pytest.raises(LogError) as refused:
        open_log(drive)
    assert refused.value.reason == reason
    log = without_damage(open_log_unchecked(drive))
    assert len(log) == COUNT - 1
    assert f"{frame} ({reason}, {Path(name).name})" in log.missing[-1]


@pytest.mark.parametrize("count", [2, 3])
def test_more_damaged_frames_than_a_tenth_are_refused_with_the_reason_of_the_first(tmp_path: Path, count: int) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", count=COUNT)
    for index in range(count):
        (drive / f"image_2/{5 + index:06d}.png").write_bytes(b"")
    assert 2 <= MOST_DAMAGED * COUNT < 3
    if count == 2:
        assert len(without_damage(open_log_unchecked(drive))) == COUNT - 2
        return
    with pytest.raises(LogError, match=r"3 of 24 frames cannot be used, the first: .*000005.png") as refused:
        without_damage(open_log_unchecked(drive))
    assert refused.value.reason == "image.empty"


def test_ingest_leaves_out_what_cannot_be_decoded_and_all_later_stages_see_the_same_log(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", count=COUNT)
    cut(drive / "image_2/000004.png")
    unpackable(drive / "image_3/000009.png")
    context = StageContext(LogSource(drive), tmp_path / "stages", ProcessSettings())
    assert len(context.log) == COUNT - 1
    (tmp_path / "stages/ingest").mkdir(parents=True)
    ingest.run(context, tmp_path / "stages/ingest", lambda share, what, /: None)
    content = read_log_file(tmp_path / "stages/ingest")
    assert {frame: one["reason"] for frame, one in content["rejected"].items()} == {"8": "image.undecodable"}
    assert "frames that were left out: 8 (image.undecodable, 000009.png)" in content["log"]["missing"]
    for seen in (context, StageContext(LogSource(drive), tmp_path / "stages", ProcessSettings())):
        assert seen.log.t_ns.tolist() == [frame.t_ns for frame in made_frames(COUNT, True) if frame.index not in (4, 9)]
    assert inspect_log(seen.log).usable


def test_a_damaged_image_in_a_recording_costs_its_frame_and_not_the_chunk(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "mcap", count=COUNT)
    file = next(drive.glob("*.mcap"))
    data, start = bytearray(file.read_bytes()), 0
    for _ in range(15):
        start = data.index(b"IDAT", start + 1)
    data[start + 40] ^= 0xFF
    file.write_bytes(data)
    log = open_log(drive)
    assert isinstance(log, StoredLog)
    (damage,) = log.damaged(decode=True)
    assert damage.error.reason == "image.checksum"
    assert len(without_frames(log, {damage.frame: damage.error})) == COUNT - 1


def test_what_is_damaged_beside_the_images_is_no_frames_fault(tmp_path: Path) -> None:
    log = open_log(write_drive(tmp_path, "mcap"))
    with pytest.raises(InputError, match="wrong check sum"):
        without_frames(log, {-1: LogError("wrong check sum")})


def test_a_drive_with_a_damaged_image_is_sent_whole_and_one_with_many_is_not(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry", count=COUNT)
    sound = {file.path for file in pack(drive).manifest.files}
    cut(drive / "image_3" / "000011.png")
    assert {file.path for file in pack(drive).manifest.files} == sound
    for number in range(4):
        cut(drive / "image_2" / f"{number:06d}.png")
    with pytest.raises(LogError, match="5 of 24 frames cannot be used"):
        pack(drive)


def test_what_ingest_left_out_is_read_once_and_anew_when_it_has_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ingest, read = tmp_path / "ingest", list[Path]()

    def reading(folder: Path) -> dict[int, LogError]:
        read.append(folder)
        return rejected_frames(folder)

    monkeypatch.setattr(log_source, "rejected_frames", reading)
    source = LogSource(write_drive(tmp_path / "drive", "kitti-odometry", count=COUNT))
    whole = [source.log_after(ingest) for _ in range(3)]
    assert len(read) == 1
    assert all(log is source.log for log in whole)
    one = {"problem": "is cut", "file": "image_2/000001.png", "reason": "image.truncated"}
    ingest.mkdir()
    (ingest / LOG_FILE).write_text(json.dumps({"format_version": FORMAT_VERSION, "rejected": {"1": one}}))
    assert [len(source.log_after(ingest)) for _ in range(3)] == [len(source.log) - 1] * 3
    assert len(read) == 2
