"""Partition of a drive's frames into overlapping parts of equal length."""

from dataclasses import dataclass

from wayloom.odometry.settings import OdometrySettings


@dataclass(frozen=True, slots=True)
class DrivePart:
    """Frames first to stop - 1 of a drive; number counts from 0. Neighbours share frames."""

    number: int
    first: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.first


def plan_parts(frames: int, settings: OdometrySettings) -> list[DrivePart]:
    """The parts of a drive of so many frames, none longer than `part_frames`; the drive itself where it is no longer than that.

    Neighbours share `part_overlap` frames, and parts differ in length by one frame at most.
    """
    if frames <= settings.part_frames:
        return [DrivePart(0, 0, frames)]
    own = settings.part_frames - settings.part_overlap
    count = -(-(frames - settings.part_overlap) // own)
    starts = [k * (frames - settings.part_overlap) // count for k in range(count + 1)]
    return [DrivePart(k, starts[k], starts[k + 1] + settings.part_overlap) for k in range(count)]
