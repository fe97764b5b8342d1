"""What leaves the window is decided upon in parts, as if it had been at once."""

import numpy as np
import pytest

from wayloom.odometry.kernels.arrays import LEFT_ALIKE, RIGHT, RIGHT_ALIKE
from wayloom.odometry.result.point_filter import PointFilter
from wayloom.odometry.result.result_builder import KeyframeRow, ResultBuilder

POINT_FILTER = PointFilter(2, 5, 0.2)
NONE = np.zeros(0, np.int64)


def drive(decide_every: int | None) -> ResultBuilder:
    """40 keyframes of two segments, five points each, which live for six keyframes; every point is seen now and then."""
    rng, builder, alive = np.random.default_rng(5), ResultBuilder(), []
    for k in range(40):
        segment = int(k >= 25)
        builder.keyframes.append(KeyframeRow(k, segment, np.eye(4), np.zeros(4)))
        alive += [(builder.next_point + i, k) for i in range(5)]
        builder.next_point += 5
        seen = np.array(
            [(number, k, rng.integers(8)) for number, host in alive if host != k and rng.random() < 0.8], np.int64
        ).reshape(-1, 3)
        builder.observations += [seen, seen[::2]]  # some while immature and while live
        gone = [(number, host) for number, host in alive if k - host >= 6 or rng.random() < 0.05 or k in (24, 39)]
        alive = [point for point in alive if point not in gone]
        if gone:
            numbers, hosts = np.array(gone).T
            builder.points.append(columns(numbers[::-1], hosts[::-1]))
        if decide_every is not None and k % decide_every == decide_every - 1:
            builder.decide_points(POINT_FILTER, np.array([number for number, _ in alive], np.int64), segment)
    builder.decide_points(POINT_FILTER, NONE, None)
    return builder


def columns(numbers: np.ndarray, hosts: np.ndarray) -> dict[str, np.ndarray]:
    rho = 0.1 + 0.01 * (numbers % 7)
    return {
        "id": numbers, "host": hosts, "uv": np.column_stack([numbers, hosts]).astype(float), "rho": rho,
        "variance": (0.05 * rho * (1 + numbers % 5)) ** 2, "grey": (numbers % 256).astype(np.uint8), "host_right": numbers % 3 > 0,
    }  # fmt: skip


def naive_points(builder: ResultBuilder) -> list[int]:
    """Numbers of the points that the filter keeps, one after the other, from a builder that never decided."""
    kept = []
    segments = [row.segment for row in builder.keyframes]
    seen = {(int(p), int(k)): int(r) for part in reversed(builder.observations) for p, k, r in part}
    for part in builder.points:
        for i, number in enumerate(part["id"]):
            others = segments.count(segments[part["host"][i]]) - 1
            observers = [r for (p, _), r in seen.items() if p == number]
            images = len(observers) + sum(noted & RIGHT for noted in observers) + int(part["host_right"][i])
            sure = np.sqrt(part["variance"][i]) < POINT_FILTER.relative_sigma * part["rho"][i]
            enough = len(observers) >= min(POINT_FILTER.observations, others) and images >= min(
                POINT_FILTER.confirmations, others + 1
            )
            kept += [int(number)] if sure and enough else []
    return sorted(kept)


@pytest.mark.parametrize("every", [1, 3, 11])
def test_points_decided_on_the_way_are_those_decided_at_the_end(every: int) -> None:
    parts, whole = drive(every).kept.points(), drive(None).kept.points()
    assert 20 < len(whole) < 180
    for name in whole.__slots__:
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
        assert getattr(parts, name).dtype == getattr(whole, name).dtype


def test_the_points_kept_are_those_of_the_filter_ordered_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = drive(None).kept.points().uv_host[:, 0].astype(int).tolist()
    monkeypatch.setattr(ResultBuilder, "decide_points", lambda *arguments: None)
    assert naive_points(drive(None)) == expected


def test_observers_of_a_kept_point_are_the_keyframes_in_which_its_patch_correlates_with_its_hosts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = drive(None).kept.points()
    monkeypatch.setattr(ResultBuilder, "decide_points", lambda *arguments: None)
    seen = {(int(p), int(k)): int(noted) for part in reversed(drive(None).observations) for p, k, noted in part}
    for i, number in enumerate(points.uv_host[:, 0].astype(int)):
        here = slice(points.obs_start[i], points.obs_start[i + 1])
        alike = sorted((k, noted) for (p, k), noted in seen.items() if p == number and noted & LEFT_ALIKE)
        assert points.obs_keyframe[here].tolist() == [k for k, _ in alike]
        assert points.obs_right[here].tolist() == [noted & RIGHT_ALIKE > 0 for _, noted in alike]
    assert (np.diff(points.obs_start) < POINT_FILTER.observations).any()  # such a point stays nevertheless


def test_what_is_settled_is_forgotten() -> None:
    builder = drive(1)
    assert sum(len(part["id"]) for part in builder.points) == 0
    assert sum(len(part) for part in builder.observations) == 0
