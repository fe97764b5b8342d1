"""TCL in the paper's form against a slow, obvious twin, and the properties that equations 2 and 3 promise."""

from collections import defaultdict
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_drive import CAMERA, RIG, HeldImages, even_images, made_drive, random_images

from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError
from wayloom.geometry.lens import RightLens
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import OdometryResult

SEEDS = st.integers(0, 10_000)
FEW = settings(max_examples=40, deadline=None)


def by_the_paper(
    drive: OdometryResult, images: HeldImages, settings: LabellingSettings = PAPER, progress: Progress = silent
) -> PointLabels:
    return label_points(drive, images, settings, progress)


def pixel(image: np.ndarray, u: float, v: float) -> int:
    """The label at the nearest pixel, void outside."""
    column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    inside = 0 <= row < image.shape[0] and 0 <= column < image.shape[1]
    return int(image[row, column]) if inside else 255


def naive_votes(drive: OdometryResult, images: HeldImages, p: int, dist_min: float, stereo: bool) -> dict[int, float]:
    """Eq. 3 in metres, one point and one image after the other."""
    points, T_world_cam = drive.points, drive.keyframes.T_world_cam
    host = int(points.host[p])
    u, v = points.uv_host[p].astype(float)
    z = 1 / float(points.inverse_depth[p])
    p_world = T_world_cam[host] @ np.array([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z, 1])
    part = slice(points.obs_start[p], points.obs_start[p + 1])
    voters = [(host, points.host_right[p]), *zip(points.obs_keyframe[part], points.obs_right[part], strict=True)]
    votes: dict[int, float] = defaultdict(float)

    def vote(image: np.ndarray, p_cam: np.ndarray, bias: float, rows: np.ndarray) -> None:
        if p_cam[2] <= dist_min:
            return
        x, y = p_cam[0] / p_cam[2], p_cam[1] / p_cam[2]
        dv = rows[0] * (1 + y * y) + rows[1] * x + rows[2] * x * y
        label = pixel(image, CAMERA.fx * x + CAMERA.cx - bias, CAMERA.fy * y + CAMERA.cy + dv)
        if label != 255:
            votes[label] += 1 / p_cam[2]

    for j, right in voters:
        p_left = (np.linalg.inv(T_world_cam[j]) @ p_world)[:3]
        if p_left[2] <= 0:
            continue
        vote(images.left(j), p_left, 0.0, np.zeros(3))
        if stereo and right:
            vote(images.right(j), p_left + RIG.t_right_left, drive.disparity_bias_px, drive.row_coefficients)
    return dict(votes)


def votes_of(labels: PointLabels, p: int) -> dict[int, float]:
    part = slice(labels.vote_start[p], labels.vote_start[p + 1])
    return {int(c): float(w) for c, w in zip(labels.vote_class[part], labels.vote_weight[part], strict=True)}


@pytest.mark.parametrize("seed", range(4))
def test_labels_and_votes_are_those_of_the_naive_twin(seed: int) -> None:
    drive, images = made_drive(seed), random_images(seed)
    labels = by_the_paper(drive, images)
    for p in range(len(drive.points)):
        u, v = drive.points.uv_host[p]
        assert labels.baseline[p] == pixel(images.left(int(drive.points.host[p])), float(u), float(v))
        for stereo, got in ((False, labels.mono[p]), (True, labels.stereo[p])):
            votes = naive_votes(drive, images, p, 2.0, stereo)
            if votes:
                assert votes[int(got)] == pytest.approx(max(votes.values()), rel=1e-6)
            else:
                assert got == labels.baseline[p]
        assert votes_of(labels, p) == pytest.approx(naive_votes(drive, images, p, 2.0, True), rel=1e-6)
    assert (labels.mono != labels.baseline).any()
    assert (labels.stereo != labels.mono).any()


def test_the_right_image_is_read_where_the_right_lens_sends_the_point() -> None:
    drive, images = made_drive(9), random_images(9)
    shifted = replace(drive, lens=RightLens(cx_shift_px=6.0))
    moved = HeldImages(images.lefts, [np.roll(image, 6, axis=1) for image in images.rights])
    one, other = by_the_paper(drive, images), by_the_paper(shifted, moved)
    # All but points whose pixels the roll brought round the border.
    assert (one.stereo == other.stereo).mean() > 0.9
    assert (one.stereo == by_the_paper(shifted, images).stereo).mean() < 0.9
    assert np.array_equal(one.mono, other.mono)


@FEW
@given(seed=SEEDS)
def test_the_order_of_the_observers_does_not_matter(seed: int) -> None:
    drive, images = made_drive(seed, points=30), random_images(seed)
    points = drive.points
    rng = np.random.default_rng(seed)
    order = np.concatenate([s + rng.permutation(e - s) for s, e in zip(points.obs_start[:-1], points.obs_start[1:], strict=True)])
    shuffled = replace(points, obs_keyframe=points.obs_keyframe[order], obs_right=points.obs_right[order])
    one, other = by_the_paper(drive, images), by_the_paper(replace(drive, points=shuffled), images)
    for field in ("baseline", "mono", "stereo", "vote_start", "vote_class", "vote_weight"):
        assert np.array_equal(getattr(one, field), getattr(other, field)), field


@FEW
@given(seed=SEEDS)
def test_the_order_of_the_points_does_not_matter(seed: int) -> None:
    drive, images = made_drive(seed, points=30), random_images(seed)
    points = drive.points
    order = np.random.default_rng(seed).permutation(len(points))
    seen = np.diff(points.obs_start)
    rows = np.concatenate([np.arange(points.obs_start[p], points.obs_start[p + 1]) for p in order])
    shuffled = replace(
        points,
        **{name: getattr(points, name)[order] for name in ("host", "uv_host", "inverse_depth", "variance", "grey", "host_right")},
        obs_start=np.concatenate([[0], np.cumsum(seen[order])]),
        obs_keyframe=points.obs_keyframe[rows],
        obs_right=points.obs_right[rows],
    )
    one, other = by_the_paper(drive, images), by_the_paper(replace(drive, points=shuffled), images)
    assert np.array_equal(one.stereo[order], other.stereo)
    assert np.array_equal(one.baseline[order], other.baseline)
    assert [votes_of(one, p) for p in order] == [votes_of(other, i) for i in range(len(order))]


def test_votes_that_wait_in_files_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, images = made_drive(7, points=40), random_images(7)
    smoothing = PAPER.model_copy(update={"spread": 0.05, "class_prior_power": 0.5})
    in_memory = [label_points(drive, images, form) for form in (PAPER, smoothing)]
    monkeypatch.setattr("wayloom.files.growing_arrays.IN_MEMORY_BYTES", 0)
    monkeypatch.setattr("wayloom.labelling.tcl.HOSTS_AT_ONCE", 1)
    monkeypatch.setattr("wayloom.labelling.neighbours.POINTS_AT_ONCE", 5)
    for form, before in zip((PAPER, smoothing), in_memory, strict=True):
        after = label_points(drive, images, form)
        for field in fields(PointLabels):
            np.testing.assert_array_equal(getattr(after, field.name), getattr(before, field.name))
    assert not after.vote_weight.flags.writeable  # it is a view of a file


@FEW
@given(seed=SEEDS)
def test_mono_without_observers_is_the_baseline(seed: int) -> None:
    drive = made_drive(seed)
    alone = replace(
        drive.points,
        obs_start=np.zeros(len(drive.points) + 1, np.int64),
        obs_keyframe=np.zeros(0, np.int32),
        obs_right=np.zeros(0, bool),
    )
    labels = by_the_paper(replace(drive, points=alone), random_images(seed))
    assert np.array_equal(labels.mono, labels.baseline)


@FEW
@given(seed=SEEDS, dist_min=st.floats(1.0, 60.0))
def test_an_observer_nearer_than_the_limit_never_votes(seed: int, dist_min: float) -> None:
    drive, images = made_drive(seed, points=40), random_images(seed)
    labels = by_the_paper(drive, images, PAPER.model_copy(update={"dist_min_m": dist_min}))
    for p in range(len(drive.points)):
        assert votes_of(labels, p) == pytest.approx(naive_votes(drive, images, p, dist_min, True), rel=1e-6)


def test_a_point_at_exactly_the_limit_does_not_vote() -> None:
    drive = made_drive(1)
    near = replace(drive.points, inverse_depth=np.full(len(drive.points), 0.5, np.float32))
    alone = replace(
        near, obs_start=np.zeros(len(near) + 1, np.int64), obs_keyframe=near.obs_keyframe[:0], obs_right=near.obs_right[:0]
    )
    labels = by_the_paper(replace(drive, points=replace(alone, host_right=np.zeros(len(near), bool))), random_images(1))
    assert len(labels.vote_class) == 0
    assert np.array_equal(labels.stereo, labels.baseline)


@FEW
@given(seed=SEEDS, label=st.integers(0, 18))
def test_a_unanimous_vote_wins(seed: int, label: int) -> None:
    drive = made_drive(seed)
    labels = by_the_paper(drive, even_images(label))
    assert (labels.mono == label).all()
    assert (labels.stereo == label).all()
    assert (labels.vote_class == label).all()


def test_void_does_not_vote_and_stays_void_where_nothing_else_speaks() -> None:
    labels = by_the_paper(made_drive(2), even_images(255))
    assert (labels.stereo == 255).all()
    assert len(labels.vote_class) == 0
    assert labels.vote_start[-1] == 0


def test_observers_outvote_a_wrong_host() -> None:
    drive = made_drive(3)
    images = even_images(8)
    images.lefts[0] = np.full_like(images.lefts[0], 4)
    labels = by_the_paper(drive, images)
    seen = np.diff(drive.points.obs_start)
    far = drive.points.inverse_depth < 1 / 12
    outvoted = (drive.points.host == 0) & (seen >= 3) & far
    assert outvoted.sum() > 3
    assert (labels.baseline[outvoted] == 4).all()
    assert (labels.stereo[outvoted] == 8).all()


def test_of_equal_votes_the_baseline_wins_else_the_lowest_class() -> None:
    drive = made_drive(4, keyframes=3, points=1)
    at_rest = np.tile(np.eye(4), (3, 1, 1))
    points = replace(
        drive.points,
        host=np.zeros(1, np.int32),
        uv_host=np.array([[50, 30]], np.float32),
        inverse_depth=np.array([0.125], np.float32),
        obs_start=np.array([0, 2], np.int64),
        obs_keyframe=np.array([1, 2], np.int32),
        obs_right=np.zeros(2, bool),
        host_right=np.zeros(1, bool),
    )
    still = replace(drive, points=points, keyframes=replace(drive.keyframes, T_world_cam=at_rest))

    def with_labels(*ids: int) -> int:
        images = [np.full((CAMERA.height, CAMERA.width), i, np.uint8) for i in ids]
        return int(by_the_paper(still, HeldImages(images, images)).mono[0])

    assert with_labels(7, 3, 255) == 7
    assert with_labels(3, 7, 255) == 3
    assert with_labels(255, 9, 5) == 5
    assert with_labels(7, 3, 3) == 3


def test_points_without_a_depth_keep_their_baseline() -> None:
    drive, images = made_drive(5), random_images(5)
    depths = drive.points.inverse_depth.copy()
    depths[::3], depths[1::3] = np.nan, -0.1
    labels = by_the_paper(replace(drive, points=replace(drive.points, inverse_depth=depths)), images)
    assert np.array_equal(labels.stereo[::3], labels.baseline[::3])
    assert np.array_equal(labels.stereo[1::3], labels.baseline[1::3])


def test_a_drive_without_points_has_no_labels() -> None:
    labels = by_the_paper(made_drive(6, points=0), random_images(6))
    assert len(labels) == 0
    assert labels.vote_start.tolist() == [0]


def test_label_images_of_another_size_are_refused() -> None:
    images = random_images(7)
    images.lefts[2] = images.lefts[2][:-1]
    with pytest.raises(StageError, match="keyframe 2"):
        by_the_paper(made_drive(7), images)


def test_progress_rises_to_one() -> None:
    shares: list[float] = []
    by_the_paper(made_drive(8), random_images(8), progress=lambda share, what: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
