"""Every frame is in a part, neighbours share what is asked for, and short drives are not cut."""

from itertools import pairwise

import pytest
from pydantic import ValidationError

from wayloom.odometry.parts.plan import DrivePart, plan_parts
from wayloom.odometry.settings import OdometrySettings

SETTINGS = OdometrySettings(part_frames=100, part_overlap=20)


@pytest.mark.parametrize("frames", [1, 99, 100])
def test_a_short_drive_is_one_part(frames: int) -> None:
    assert plan_parts(frames, SETTINGS) == [DrivePart(0, 0, frames)]


@pytest.mark.parametrize("frames", [101, 180, 181, 999, 36_000])
def test_parts_cover_the_drive_and_overlap_as_asked(frames: int) -> None:
    parts = plan_parts(frames, SETTINGS)
    assert [part.number for part in parts] == list(range(len(parts)))
    assert (parts[0].first, parts[-1].stop) == (0, frames)
    assert all(before.stop - after.first == SETTINGS.part_overlap for before, after in pairwise(parts))
    lengths = [len(part) for part in parts]
    assert max(lengths) <= SETTINGS.part_frames
    assert max(lengths) - min(lengths) <= 1
    assert len(parts) == 1 + -(-(frames - 100) // 80)


def test_an_overlap_of_more_than_half_a_part_is_refused() -> None:
    with pytest.raises(ValidationError, match="half of part_frames"):
        OdometrySettings(part_frames=100, part_overlap=51)
