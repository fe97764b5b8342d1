"""What the odometry says of each frame, and in which order observers are told."""

from collections.abc import Iterator

import numpy as np
import pytest
from made_street import MadeLog, curve

from wayloom.odometry import frame_source
from wayloom.odometry.mapper import Mapper
from wayloom.odometry.odometry import Odometry, track
from wayloom.odometry.points import activation
from wayloom.odometry.rig.posed_pair import PosedPair
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracker import Tracker
from wayloom.odometry.tracking.frame import GreyPair
from wayloom.odometry.tracking.frame_status import FIRST_OF_A_SEGMENT, FrameStatus
from wayloom.odometry.types import OdometryResult

SETTINGS = OdometrySettings()
BLANK, JUMP = 5, 10
"""Frame 5 is black; from frame 10 on the car is elsewhere."""


def black(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return left * 0, right * 0


def jumping_drive() -> MadeLog:
    """The first ten frames of a curve, then another street: the same one looked at upside down."""
    turned = dict.fromkeys(range(JUMP, 22), lambda left, right: (left[::-1].copy(), right[::-1].copy()))
    return MadeLog(curve(22), changes={BLANK: black, **turned})


class Told:
    """Notes who is told what."""

    def __init__(self, name: str, notes: list[tuple[str, str, object]]) -> None:
        self.name, self.notes = name, notes
        self.statuses: list[FrameStatus] = []

    def note(self, what: str, which: object) -> None:
        self.notes.append((self.name, what, which))

    def on_adjustment(self, mapper: Mapper, /) -> None:
        self.note("adjustment", mapper.builder.keyframes[-1].frame)

    def on_interrupt(self, /) -> None:
        self.note("interrupt", None)

    def on_keyframe(self, pair: PosedPair, /) -> None:
        self.note("keyframe", pair.frame)

    def on_frame(self, pair: GreyPair, status: FrameStatus, tracker: Tracker, mapper: Mapper, /) -> None:
        assert pair.index == status.index == len(mapper.builder.frames) - 1
        if status.is_keyframe:
            assert tracker.references[-1].keyframe == mapper.window.keyframe[-1] == len(mapper.builder.keyframes) - 1
        self.statuses.append(status)
        self.note("frame", pair.index)

    def on_finish(self, mapper: Mapper, /) -> None:
        self.note("finish", None)


@pytest.fixture(scope="module")
def told() -> tuple[list[tuple[str, str, object]], list[FrameStatus], OdometryResult]:
    notes: list[tuple[str, str, object]] = []
    first, second = Told("first", notes), Told("second", notes)
    result = track(jumping_drive(), observers=(first, second))
    assert first.statuses == second.statuses
    return notes, first.statuses, result


def test_each_frame_has_a_status_that_agrees_with_the_result(told) -> None:
    _, statuses, result = told
    assert [status.index for status in statuses] == list(range(22))
    assert [status.tracked for status in statuses] == result.trajectory.tracked.tolist()
    assert [status.segment for status in statuses] == result.trajectory.segment.tolist()
    assert [status.index for status in statuses if status.is_keyframe] == result.keyframes.frame.tolist()
    losses = [{"frame": status.index, "reason": reason} for status in statuses for reason in status.failures]
    assert losses == result.report["losses"]


def test_a_status_says_tracked_keyframe_held_and_lost(told) -> None:
    statuses = told[1]
    first, tracked, held = statuses[0], next(s for s in statuses if not s.is_keyframe), statuses[BLANK]
    assert (first.tracked, first.keyframe_reason, first.new_segment, first.alignment) == (True, FIRST_OF_A_SEGMENT, True, None)
    assert (tracked.tracked, tracked.new_segment, tracked.lost, tracked.failure) == (True, False, False, None)
    assert tracked.alignment is not None
    assert tracked.alignment.failure is None
    assert (held.tracked, held.is_keyframe, held.lost, held.failure) == (False, False, False, "the image is blank")
    later = [s for s in statuses if s.is_keyframe and not s.new_segment]
    assert later
    assert all(s.tracked and s.keyframe_reason not in (None, FIRST_OF_A_SEGMENT) and s.alignment for s in later)


def test_frames_are_held_until_patience_ends_and_then_a_new_segment_starts(told) -> None:
    statuses = told[1]
    after = statuses[JUMP:]
    held, begun = after[: SETTINGS.patience], after[SETTINGS.patience]
    assert not any(s.tracked or s.lost or s.new_segment for s in held)
    assert all(s.alignment is not None and s.failure == s.alignment.failure for s in held)
    assert (begun.lost, begun.new_segment, begun.tracked, begun.segment) == (True, True, True, 1)
    assert begun.keyframe_reason == FIRST_OF_A_SEGMENT
    assert begun.alignment is not None
    assert begun.failures == (begun.alignment.failure,)
    assert sum(s.lost for s in statuses) == 1
    assert all(s.segment == 1 for s in after[SETTINGS.patience :])


def test_a_window_that_is_given_up_without_a_new_start_gives_both_reasons() -> None:
    changes = dict.fromkeys(range(4, 8), lambda left, right: (left[::-1].copy(), right * 0))
    watched = Told("watched", [])
    result = track(MadeLog(curve(8), changes=changes), OdometrySettings(patience=1), observers=(watched,))
    lost = watched.statuses[5]
    assert (lost.lost, lost.tracked, lost.new_segment, len(lost.failures)) == (True, False, False, 2)
    assert "stereo finds depth at" in str(lost.failure)
    assert [loss["reason"] for loss in result.report["losses"] if loss["frame"] == 5] == list(lost.failures)


def told_of(index: int, notes: list[tuple[str, str, object]], name: str) -> list[str]:
    """What an observer was told between the frame before and this one's end."""
    mine = [(what, which) for who, what, which in notes if who == name]
    start = 0 if index == 0 else mine.index(("frame", index - 1)) + 1
    return [what for what, _ in mine[start : mine.index(("frame", index)) + 1]]


@pytest.mark.parametrize("name", ["first", "second"])
def test_observers_are_told_of_adjustment_interrupt_keyframe_and_frame_in_this_order(told, name: str) -> None:
    notes, statuses, _ = told
    for status in statuses:
        expected = ["adjustment"] if status.is_keyframe and not status.new_segment else []
        expected += ["interrupt"] if status.lost else []
        expected += ["keyframe"] if status.is_keyframe else []
        assert told_of(status.index, notes, name) == [*expected, "frame"]
    assert [what for who, what, _ in notes if who == name][-1] == "finish"
    assert sum(what == "finish" for who, what, _ in notes if who == name) == 1


def test_observers_are_told_one_after_the_other(told) -> None:
    notes = told[0]
    alone = [[note[1:] for note in notes if note[0] == name] for name in ("first", "second")]
    assert alone[0] == alone[1]
    for what in ("adjustment", "keyframe", "frame", "finish"):
        names = [who for who, said, _ in notes if said == what]
        assert names == ["first", "second"] * (len(names) // 2)


def pairs(log: MadeLog) -> Iterator[GreyPair]:
    return (frame_source.grey_pair(log, index) for index in range(len(log)))


def test_a_first_keyframe_is_rectified_and_matched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    log, counts = MadeLog(curve(2)), {"stereo": 0, "rectified": 0}
    stereo, align = activation.stereo_candidates, RightRectifier.align

    def counted_stereo(*arguments):  # type: ignore[no-untyped-def]
        counts["stereo"] += 1
        return stereo(*arguments)

    def counted_align(*arguments):  # type: ignore[no-untyped-def]
        counts["rectified"] += 1
        return align(*arguments)

    monkeypatch.setattr(activation, "stereo_candidates", counted_stereo)
    monkeypatch.setattr(RightRectifier, "align", counted_align)
    odometry = Odometry(RightRectifier(log.rig, frame_source.IDENTITY, np.zeros(3)), SETTINGS)
    assert odometry.process(next(pairs(log))).new_segment
    assert counts == {"stereo": 1, "rectified": 1}


def test_the_parts_track_a_drive_without_a_log_to_stream_from() -> None:
    log = MadeLog(curve(6))
    odometry = Odometry(RightRectifier(log.rig, frame_source.IDENTITY, np.zeros(3)), SETTINGS)
    statuses = [odometry.process(pair) for pair in pairs(log)]
    assert all(status.tracked for status in statuses)
    result = odometry.finish()
    np.testing.assert_array_equal(result.trajectory.T_world_cam, track(log, OdometrySettings(row_frames=())).trajectory.T_world_cam)
