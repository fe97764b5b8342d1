"""What goes beyond the paper, switch by switch."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_drive import CAMERA, HeldImages, even_images, made_drive, random_images, still_drive, texture

from wayloom.config.classes import VOID
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.labelling.types import PointLabels
from wayloom.labelling.voting_frames import voting_frames
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.scores import scores_from_logits

FEW = settings(max_examples=20, deadline=None)
HARD = LabellingSettings(votes="hard", spread=0.0)


def labels_of(*ids: int) -> HeldImages:
    """One even label image a keyframe, all with the same texture."""
    images = [np.full((CAMERA.height, CAMERA.width), i, np.uint8) for i in ids]
    return HeldImages(images, images, smalls=[texture(0)] * len(ids))


def weight(labels: PointLabels, p: int, label: int) -> float:
    part = slice(labels.vote_start[p], labels.vote_start[p + 1])
    return float(labels.vote_weight[part][labels.vote_class[part] == label].sum())


def test_a_keyframe_that_the_odometry_did_not_ask_votes_if_the_point_looks_alike_there() -> None:
    images = labels_of(8, 8, 4, 8, 8)
    by_paper, by_looks = label_points(still_drive(), images, PAPER), label_points(still_drive(), images, HARD)
    assert (by_paper.mono == 4).all()
    assert (by_looks.baseline == 4).all()
    assert (by_looks.mono == 8).all()


def test_a_keyframe_beyond_the_reach_does_not_vote() -> None:
    images = labels_of(8, 4, 4, 4, 8)
    labels = label_points(still_drive(), images, HARD.model_copy(update={"reach": 1}))
    assert (labels.vote_class == 4).all()
    assert weight(label_points(still_drive(), images, HARD), 0, 8) > 0


def test_a_keyframe_in_which_the_point_looks_different_hardly_votes() -> None:
    images = labels_of(8, 8, 4, 8, 8)
    assert images.smalls is not None
    for k in (0, 1, 3, 4):
        images.smalls[k] = texture(10 + k)
    labels = label_points(still_drive(), images, HARD)
    assert (labels.mono == 4).mean() > 0.85
    anyone = label_points(still_drive(), images, HARD.model_copy(update={"ncc_power": 0.0}))
    assert (anyone.mono == 8).all()


def test_a_keyframe_of_another_segment_does_not_vote_beyond_obs() -> None:
    drive = still_drive()
    apart = replace(drive, keyframes=replace(drive.keyframes, segment=np.array([0, 0, 0, 1, 1], np.int32)))
    labels = label_points(apart, labels_of(4, 4, 4, 8, 8), HARD)
    assert (labels.vote_class == 4).all()


@FEW
@given(seed=st.integers(0, 10_000), dist_min=st.floats(1.0, 60.0))
def test_in_no_form_does_an_observer_nearer_than_the_limit_vote(seed: int, dist_min: float) -> None:
    drive, images = with_texture(seed)
    labels = label_points(drive, images, HARD.model_copy(update={"dist_min_m": dist_min, "inverse_depth_power": 0.0}))
    every = label_points(drive, images, HARD.model_copy(update={"dist_min_m": 0.01, "inverse_depth_power": 0.0}))
    for p in range(len(drive.points)):
        assert weight_of_all(labels, p) <= weight_of_all(every, p) + 1e-5
    near = label_points(drive, images, HARD.model_copy(update={"dist_min_m": 100.0}))
    assert len(near.vote_class) == 0
    assert np.array_equal(near.stereo, near.baseline)


def weight_of_all(labels: PointLabels, p: int) -> float:
    return float(labels.vote_weight[labels.vote_start[p] : labels.vote_start[p + 1]].sum())


def with_texture(seed: int) -> tuple[OdometryResult, HeldImages]:
    images = random_images(seed)
    images.smalls = [texture(seed)] * 5
    return made_drive(seed, points=30), images


@FEW
@given(seed=st.integers(0, 10_000))
def test_the_order_of_observers_and_points_does_not_matter_in_the_default_form_either(seed: int) -> None:
    drive, images = with_texture(seed)
    points = drive.points
    rng = np.random.default_rng(seed)
    order = np.concatenate([s + rng.permutation(e - s) for s, e in zip(points.obs_start[:-1], points.obs_start[1:], strict=True)])
    shuffled = replace(points, obs_keyframe=points.obs_keyframe[order], obs_right=points.obs_right[order])
    one, other = label_points(drive, images), label_points(replace(drive, points=shuffled), images)
    for field in ("baseline", "mono", "stereo", "vote_start", "vote_class", "vote_weight"):
        assert np.array_equal(getattr(one, field), getattr(other, field)), field


class NoRightLabels(HeldImages):
    """Whose right label images must not be asked for."""

    def right(self, keyframe: int, /) -> np.ndarray:
        raise AssertionError(f"right labels of keyframe {keyframe} were read")


def test_right_labels_are_not_read_where_scores_say_all() -> None:
    drive, images = with_texture(6)
    rng = np.random.default_rng(6)
    size = (CAMERA.height, CAMERA.width)
    ids = np.arange(19, dtype=np.uint8)
    scores = [scores_from_logits(rng.normal(0, 3, (15, 25, 19)).astype(np.float32), ids, size) for _ in range(5)]
    lefts, rights = (
        [np.where(image == 255, 0, image).astype(np.uint8) for image in side] for side in (images.lefts, images.rights)
    )
    one = label_points(drive, HeldImages(lefts, rights, (scores, scores), images.smalls))
    other = label_points(drive, NoRightLabels(lefts, [], (scores, scores), images.smalls, may_be_void=False))
    assert np.array_equal(one.vote_weight, other.vote_weight)
    assert np.array_equal(one.stereo, other.stereo)
    assert (one.stereo != one.mono).any()


def test_a_projection_behind_a_seen_point_does_not_vote_where_that_is_asked() -> None:
    drive, images = still_drive(points=2), labels_of(8, 8, 4, 8, 8)
    drive.points.uv_host[:] = 40.0
    drive.points.inverse_depth[:] = 0.25, 0.05
    seen_everywhere = replace(
        drive.points,
        obs_start=np.array([0, 4, 4], np.int64),
        obs_keyframe=np.array([0, 1, 3, 4], np.int32),
        obs_right=np.zeros(4, bool),
    )
    drive = replace(drive, points=seen_everywhere)
    assert label_points(drive, images, HARD).mono.tolist() == [8, 8]
    checked = label_points(drive, images, HARD.model_copy(update={"occlusion_check": True}))
    assert checked.mono.tolist() == [8, 4]


def test_votes_near_label_boundaries_count_less_where_that_is_asked() -> None:
    drive = still_drive(points=1)
    drive.points.uv_host[:] = 50.0, 30.0
    images = even_images(4)
    images.smalls = [texture(0)] * 5
    for k in (0, 1, 3):
        images.lefts[k] = images.lefts[k].copy()
        images.lefts[k][:, 50:] = 8
    assert label_points(drive, images, HARD).mono.tolist() == [8]
    assert label_points(drive, images, HARD.model_copy(update={"boundary_px": 10.0})).mono.tolist() == [4]


def test_uncertain_projections_count_less_where_that_is_asked() -> None:
    drive = made_drive(3, points=60)
    images = random_images(3)
    images.smalls = [texture(0)] * 5
    sure = replace(drive, points=replace(drive.points, variance=np.full(60, 1e-12, np.float32)))
    vague = replace(drive, points=replace(drive.points, variance=np.full(60, 1e-2, np.float32)))
    asked = PAPER.model_copy(update={"reprojection_px": 1.0})
    plain, with_sure, with_vague = (
        sum(label_points(d, images, s).vote_weight) for d, s in ((drive, PAPER), (sure, asked), (vague, asked))
    )
    assert with_sure == pytest.approx(plain, rel=1e-3)
    assert with_vague < 0.8 * plain


def test_frames_between_keyframes_vote_where_that_is_asked() -> None:
    drive = still_drive(keyframes=5, points=10)
    rows = np.array([0, 2, 4])
    points = replace(drive.points, host=np.full(10, 1, np.int32))
    keyframes = replace(
        drive.keyframes, frame=rows.astype(np.int32), T_world_cam=drive.keyframes.T_world_cam[rows],
        affine=drive.keyframes.affine[rows], segment=drive.keyframes.segment[rows],
    )  # fmt: skip
    trajectory = replace(drive.trajectory, T_world_cam=np.tile(np.eye(4), (5, 1, 1)), tracked=np.array([1, 1, 1, 0, 1], bool))
    drive = replace(drive, points=points, keyframes=keyframes, trajectory=trajectory)
    between = HARD.model_copy(update={"between_keyframes": True})
    assert voting_frames(drive, HARD).tolist() == [0, 2, 4]
    assert voting_frames(drive, between).tolist() == [0, 1, 2, 4]
    assert (label_points(drive, labels_of(8, 4, 8), HARD).mono == 8).all()
    labels = label_points(drive, labels_of(8, 8, 4, 8), between)
    assert (labels.baseline == 4).all()
    assert (labels.mono == 8).all()


@pytest.mark.parametrize(("every", "voting"), [(0, ()), (2, (0, 2, 4)), (3, (0, 3))])
def test_only_some_right_images_vote_and_no_other_is_read(every: int, voting: tuple[int, ...]) -> None:
    drive, images = made_drive(7), random_images(7)
    form = HARD.model_copy(update={"ncc_power": 0.0, "reach": 3, "right_images": every})
    rows, nothing = range(len(images.rights)), np.full_like(images.rights[0], VOID)
    voids = replace(images, rights=[images.rights[row] if row in voting else nothing for row in rows])
    refused = np.zeros((1, 1), np.uint8)  # of a size that raises where it is read
    some = replace(images, rights=[images.rights[row] if row in voting else refused for row in rows])
    expected = label_points(drive, voids, form.model_copy(update={"right_images": 1}))
    found = label_points(drive, some, form)
    for name in ("baseline", "mono", "stereo", "vote_start", "vote_class", "vote_weight"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_nearness_may_count_more_or_not_at_all() -> None:
    drive, images = with_texture(5)
    flat = label_points(drive, images, PAPER.model_copy(update={"inverse_depth_power": 0.0}))
    assert np.array_equal(flat.vote_weight, np.round(flat.vote_weight))
    assert (
        label_points(drive, images, PAPER.model_copy(update={"inverse_depth_power": 2.0})).vote_weight < flat.vote_weight.max()
    ).all()
