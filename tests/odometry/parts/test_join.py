"""Parts without error join to the drive that they were cut from: nothing twice, nothing lost but what was seen beyond the cuts."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_parts import lost, made_part, way

from wayloom.errors import StageError
from wayloom.odometry.parts.join import NO_COMMON_FRAMES, join_parts
from wayloom.odometry.parts.plan import DrivePart, plan_parts
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult

FRAMES = 260
TRUTH = way(FRAMES)
PARTS = plan_parts(FRAMES, OdometrySettings(part_frames=100, part_overlap=20))
CUTS = [(a.stop + b.first) // 2 for a, b in pairwise(PARTS)]


def joined(results: Sequence[OdometryResult]) -> OdometryResult:
    return join_parts(PARTS, lambda part: results[part.number])


def made(every: Sequence[int] = (3, 4, 3)) -> list[OdometryResult]:
    return [made_part(TRUTH, part, step) for part, step in zip(PARTS, every, strict=True)]


def owner(frame: int) -> int:
    """The part whose a frame is."""
    return int(np.searchsorted(CUTS, frame, side="right"))


def naive_points(results: Sequence[OdometryResult]) -> list[tuple[int, tuple[float, ...], list[tuple[int, bool]]]]:
    """Of every point that stays: frame of its host, its pixel, and the frames in which it was seen, one after the other."""
    kept = []
    frames = {
        int(f) + part.first
        for part, r in zip(PARTS, results, strict=True)
        for f in r.keyframes.frame
        if owner(f + part.first) == part.number
    }
    for part, result in zip(PARTS, results, strict=True):
        p, frame = result.points, result.keyframes.frame + part.first
        for i in range(len(p)):
            host = int(frame[p.host[i]])
            if owner(host) != part.number:
                continue
            rows = range(p.obs_start[i], p.obs_start[i + 1])
            seen = [(int(frame[p.obs_keyframe[m]]), bool(p.obs_right[m])) for m in rows if int(frame[p.obs_keyframe[m]]) in frames]
            kept.append((host, tuple(p.uv_host[i].tolist()), seen))
    return kept


def test_parts_without_error_give_the_drive_back() -> None:
    result = joined(made())
    np.testing.assert_allclose(result.trajectory.T_world_cam, TRUTH, atol=1e-9)
    np.testing.assert_array_equal(result.trajectory.t_ns, np.arange(FRAMES) * 100_000_000)
    assert result.trajectory.tracked.all()
    assert not result.trajectory.segment.any()
    np.testing.assert_allclose(result.keyframes.T_world_cam, TRUTH[result.keyframes.frame], atol=1e-9)
    assert (np.diff(result.keyframes.frame) > 0).all()
    assert not result.keyframes.segment.any()
    assert [row["frame"] for row in result.report["joints"]] == CUTS


@pytest.mark.parametrize("every", [(3, 3, 3), (3, 4, 3), (5, 2, 7)])
def test_points_and_observations_are_those_of_the_naive_twin(every: tuple[int, int, int]) -> None:
    results = made(every)
    result = joined(results)
    p, frame = result.points, result.keyframes.frame
    found = [
        (
            int(frame[p.host[i]]),
            tuple(p.uv_host[i].tolist()),
            [(int(frame[p.obs_keyframe[m]]), bool(p.obs_right[m])) for m in range(p.obs_start[i], p.obs_start[i + 1])],
        )
        for i in range(len(p))
    ]
    assert found == naive_points(results)
    assert len(found) > 0.9 * 4 * len(frame)
    np.testing.assert_array_equal(p.grey, (frame[p.host] % 256).astype(np.uint8))


def test_types_are_those_of_a_drive_in_one_piece() -> None:
    results = made()
    result = joined(results)
    for group in ("trajectory", "keyframes", "points"):
        for name in type(getattr(result, group)).__slots__:
            assert getattr(getattr(result, group), name).dtype == getattr(getattr(results[0], group), name).dtype, name


def test_the_report_counts_the_drive() -> None:
    results = made()
    report = joined(results).report
    assert (report["frames"], report["tracked"], report["losses"]) == (FRAMES, FRAMES, [])
    assert report["segments"] == [{"first_frame": 0, "last_frame": FRAMES - 1}]
    assert report["activated_points"] == sum(result.report["activated_points"] for result in results)
    assert report["seconds"] == {"track": 3.0}
    assert [row["first_frame"] for row in report["parts"]] == [part.first for part in PARTS]


def test_losses_within_parts_stay_losses_and_joints_are_none() -> None:
    results = made()
    results[1] = lost(results[1], 40, 45, new_segment=True)
    first = PARTS[1].first + 45
    result = joined(results)
    np.testing.assert_array_equal(result.trajectory.segment, (np.arange(FRAMES) >= first).astype(np.int32))
    np.testing.assert_array_equal(result.keyframes.segment, (result.keyframes.frame >= first).astype(np.int32))
    assert [loss["frame"] for loss in result.report["losses"]] == list(range(first - 5, first))
    assert [row["first_frame"] for row in result.report["segments"]] == [0, first]


def test_a_loss_in_the_overlap_moves_the_cut_to_where_both_tracked() -> None:
    results = made()
    within = PARTS[0].stop - PARTS[1].first
    results[0] = lost(results[0], len(PARTS[0]) - 8, len(PARTS[0]), new_segment=False)
    result = joined(results)
    assert result.report["joints"][0]["frame"] == PARTS[1].first + (within - 8) // 2
    assert result.trajectory.tracked.all()
    assert result.report["losses"] == []
    assert not result.trajectory.segment.any()
    np.testing.assert_allclose(result.trajectory.T_world_cam, TRUTH, atol=1e-9)


def test_parts_that_tracked_no_frames_in_common_are_two_segments() -> None:
    results = made()
    overlap = PARTS[0].stop - PARTS[1].first
    results[0] = lost(results[0], len(PARTS[0]) - overlap // 2, len(PARTS[0]), new_segment=False)
    results[1] = lost(results[1], 0, overlap // 2, new_segment=False)
    result = joined(results)
    cut = PARTS[1].first + overlap // 2
    np.testing.assert_array_equal(result.trajectory.segment, (np.arange(FRAMES) >= cut).astype(np.int32))
    assert result.trajectory.tracked.all()
    assert {"frame": cut, "reason": NO_COMMON_FRAMES} in result.report["losses"]
    assert result.report["joints"][0] == {"frame": cut, "common_frames": 0}
    within = np.linalg.inv(result.trajectory.T_world_cam[cut]) @ result.trajectory.T_world_cam[cut:]
    np.testing.assert_allclose(within, np.linalg.inv(TRUTH[cut]) @ TRUTH[cut:], atol=1e-9)


def test_frames_that_neither_part_tracked_stay_untracked() -> None:
    results = made()
    overlap = PARTS[0].stop - PARTS[1].first
    results[0] = lost(results[0], len(PARTS[0]) - overlap, len(PARTS[0]), new_segment=False)
    results[1] = lost(results[1], 0, overlap, new_segment=False)
    result = joined(results)
    assert int((~result.trajectory.tracked).sum()) == overlap
    assert set(np.unique(result.trajectory.segment)) == {0, 1}


def test_the_result_of_another_part_is_refused() -> None:
    results = made()
    results[1] = made_part(TRUTH, DrivePart(1, PARTS[1].first, PARTS[1].stop - 3), 3)
    with pytest.raises(StageError, match="part 1 has"):
        joined(results)


def test_the_calibration_is_that_of_the_last_part() -> None:
    results = made()
    results[-1] = replace(results[-1], disparity_bias_px=0.4)
    assert joined(results).disparity_bias_px == 0.4


def test_steps_keep_their_covariance_and_the_one_over_a_cut_has_the_joints_too() -> None:
    results, own = [], np.eye(6, dtype=np.float32) * np.float32(1e-6)
    for result in made():
        known = np.tile(own, (len(result.keyframes), 1, 1))
        known[0] = np.nan
        results.append(replace(result, keyframes=replace(result.keyframes, step_covariance=known)))
    keyframes = joined(results).keyframes
    over = np.isin(np.arange(len(keyframes)), np.searchsorted(keyframes.frame, CUTS))
    assert np.isnan(keyframes.step_covariance[0]).all()
    np.testing.assert_array_equal(keyframes.step_covariance[1:][~over[1:]], np.tile(own, ((~over[1:]).sum(), 1, 1)))
    added = keyframes.step_covariance[over] - own
    np.testing.assert_allclose(added, np.tile(1e-12 * np.eye(6), (len(CUTS), 1, 1)), atol=2e-13)
    assert keyframes.step_covariance.dtype == np.float32
