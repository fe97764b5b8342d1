"""Status of a processed frame: tracked, held or lost, and the keyframe or segment that it began."""

from dataclasses import dataclass

from wayloom.odometry.tracking.recovery import TrackingResult

FIRST_OF_A_SEGMENT = "first of a segment"


@dataclass(frozen=True, slots=True)
class FrameStatus:
    """What the odometry did with a frame.

    index            the frame's number in the drive
    segment          that it belongs to, counted from 0
    tracked          whether its pose was found; False where it is held at the predicted one
    keyframe_reason  why it became a keyframe; None where it did not
    new_segment      whether it is the first keyframe of its segment
    lost             whether the window before it was given up: too many failures in a row
    failures         reasons for which it could not be tracked, in the order they were met; two where the window was given up and no
                     new segment could be started either
    alignment        with a keyframe of the window, whether it was believed or not; None where none was tried
    """

    index: int
    segment: int
    tracked: bool
    keyframe_reason: str | None = None
    new_segment: bool = False
    lost: bool = False
    failures: tuple[str, ...] = ()
    alignment: TrackingResult | None = None

    @property
    def is_keyframe(self) -> bool:
        """Whether the frame became a keyframe."""
        return self.keyframe_reason is not None

    @property
    def failure(self) -> str | None:
        """The last of its failures, None where there was none."""
        return self.failures[-1] if self.failures else None
