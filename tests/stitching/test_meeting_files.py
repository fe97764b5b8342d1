"""File of meetings: what is written is read again, and damage is named."""

from pathlib import Path

import numpy as np
import pytest

from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.stitching.meeting_files import load_meetings, save_meetings
from wayloom.stitching.meetings import DriveMeetings
from wayloom.stitching.types import Meeting


def some_meetings() -> DriveMeetings:
    """Two of them."""
    T = se3.exp(np.array([1.0, 2.0, -0.5, 0.01, -0.02, 3.0]))
    return DriveMeetings((Meeting("a", 0, "b", 2, T, np.eye(6) / 3.0), Meeting("a", 1, "b", 1, np.eye(4), np.eye(6))), {"tried": 3})


def test_meetings_are_read_as_they_were_written(tmp_path: Path) -> None:
    save_meetings(some_meetings(), tmp_path / "meetings.json")
    read = load_meetings(tmp_path / "meetings.json")
    assert read.report == {"tried": 3}
    for one, other in zip(read.meetings, some_meetings().meetings, strict=True):
        assert (one.drive_a, one.submap_a, one.drive_b, one.submap_b) == (
            other.drive_a,
            other.submap_a,
            other.drive_b,
            other.submap_b,
        )
        assert one.T_a_b.tobytes() == other.T_a_b.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes()


def test_equal_meetings_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("one", "other"):
        save_meetings(some_meetings(), tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


WITHOUT_POSE = '{"format": "wayloom-meetings", "version": 1, "meetings": [{}], "report": {}}'


@pytest.mark.parametrize("content", ["", "{}", "[]", WITHOUT_POSE])
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "meetings.json"
    path.write_text(content)
    with pytest.raises(StageError, match=r"meetings\.json.*register the two drives again"):
        load_meetings(path)


def test_another_version_is_named(tmp_path: Path) -> None:
    path = tmp_path / "meetings.json"
    path.write_text('{"format": "wayloom-meetings", "version": 9}')
    with pytest.raises(StageError, match="version 9"):
        load_meetings(path)
