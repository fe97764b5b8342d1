"""The labelling's kernels against slow, obvious twins."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_drive import CAMERA

from wayloom.labelling.kernels import visibility, voting
from wayloom.segmentation.scores import STEPS_PER_NAT, Scores, rest_steps, scores_from_logits

pytestmark = pytest.mark.kernels

SEEDS = st.integers(0, 10_000)
FEW = settings(max_examples=40, deadline=None)


def naive_grey(image: np.ndarray, u: float, v: float) -> float:
    """Bilinear by the definition, the border's value beyond it."""
    u, v = min(max(u, 0), image.shape[1] - 1), min(max(v, 0), image.shape[0] - 1)
    value = 0.0
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value += max(0, 1 - abs(u - column)) * max(0, 1 - abs(v - row)) * float(image[row, column])
    return value


@FEW
@given(seed=SEEDS, scale=st.floats(0.4, 2.5))
def test_descriptors_and_their_correlation_are_those_of_the_naive_twin(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, (9, 11)).astype(np.uint8)
    uv = rng.uniform([-2, -2], [12, 10], (4, 2))
    descriptors = visibility.patch_descriptors(image, uv, np.full(4, scale))
    for n, (u, v) in enumerate(uv):
        values = np.array([naive_grey(image, u + du * scale, v + dv * scale) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
        values -= values.mean()
        norm = np.linalg.norm(values)
        assert descriptors[n] == pytest.approx(values / norm if norm > 1 else np.zeros(9), abs=2e-4)
    of_others = descriptors[::-1].copy()
    d_observer, inverse_depth = np.full(4, 0.2 * scale, np.float32), np.full(4, 0.2)
    candidate = np.array([True, True, False, True])
    for min_ncc, power in ((0.0, 1.0), (0.3, 4.0), (0.2, 2.5)):
        weights = visibility.ncc_weights(
            of_others, image, 1, image.shape, uv, d_observer, inverse_depth, candidate, min_ncc, np.float32(power)
        )
        for n, (u, v) in enumerate(uv):
            r = min(float(descriptors[n] @ of_others[n]), 1.0)
            seen = candidate[n] and -0.5 <= u < 10.5 and -0.5 <= v < 8.5 and r >= min_ncc
            assert weights[n] == pytest.approx(r**power if seen else 0.0, abs=5e-4) or abs(r - min_ncc) < 2e-4


def correlation_at(image: np.ndarray, descriptors: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Their normalised cross-correlation with the patches at uv in an image, at the same scale."""
    near = np.full(len(uv), 0.1)
    found: np.ndarray = visibility.ncc_weights(
        descriptors, image, 1, image.shape, uv, near.astype(np.float32), near, np.ones(len(uv), bool), 0.0, np.float32(1.0)
    )
    return found


def test_a_flat_patch_and_one_that_is_nowhere_have_zero_descriptors() -> None:
    image = np.full((20, 20), 90, np.uint8)
    uv = np.array([[5.0, 5.0], [np.nan, 5.0], [np.inf, 5.0]])
    assert not visibility.patch_descriptors(image, uv, np.ones(3)).any()


def test_the_correlation_does_not_depend_on_brightness_and_contrast() -> None:
    rng = np.random.default_rng(1)
    image = cv2.GaussianBlur(rng.integers(0, 120, (40, 40)).astype(np.uint8), (0, 0), 1.5)
    brighter = (image * 1.6 + 20).astype(np.uint8)
    uv = rng.uniform(5, 35, (50, 2))
    descriptors = visibility.patch_descriptors(image, uv, np.ones(50))
    assert (correlation_at(brighter, descriptors, uv) > 0.98).all()
    assert np.median(correlation_at(image, descriptors, uv + 4.0)) < 0.6


@FEW
@given(seed=SEEDS)
def test_a_projection_behind_a_seen_point_is_occluded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen_uv, seen_d = rng.uniform([-5, -5], [105, 65], (60, 2)), rng.uniform(0.01, 0.5, 60).astype(np.float32)
    uv, d = rng.uniform([-5, -5], [105, 65], (80, 2)), rng.uniform(0.01, 0.5, 80).astype(np.float32)
    grid = visibility.occlusion_buffer(seen_uv, seen_d, 8.0, 8, 13)
    found = visibility.occluded(uv, d, grid, 8.0, 0.15)

    def cell(p: np.ndarray) -> tuple[int, int] | None:
        column, row = np.floor((p + 0.5) / 8.0).astype(int)
        return (row, column) if 0 <= row < 8 and 0 <= column < 13 else None

    for n in range(80):
        nearer = [s for q, s in zip(seen_uv, seen_d, strict=True) if cell(uv[n]) is not None and cell(q) == cell(uv[n])]
        assert found[n] == any(s * np.float32(1 - 0.15) > d[n] for s in nearer)


def naive_soft_vote(scores: Scores, u: float, v: float) -> np.ndarray:
    """Probabilities at a pixel: ln p of every class in every cell, taken bilinearly, by the definition."""
    gh, gw, k = scores.classes.shape
    covered, rest = scores.covered, rest_steps(scores)
    nats = np.zeros((gh, gw, 19))
    for r in range(gh):
        for c in range(gw):
            nats[r, c] = -rest[r, c] / STEPS_PER_NAT
            for i in range(k):
                nats[r, c, scores.classes[r, c, i]] = -float(scores.steps[r, c, i]) / STEPS_PER_NAT
    sv = np.clip((v + 0.5) * gh / covered[0] - 0.5, 0, gh - 1)
    su = np.clip((u + 0.5) * gw / covered[1] - 0.5, 0, gw - 1)
    mean = np.zeros(19)
    for r in range(gh):
        for c in range(gw):
            mean += max(0, 1 - abs(sv - r)) * max(0, 1 - abs(su - c)) * nats[r, c]
    shares = np.exp(mean - mean.max())
    shares[shares < np.exp(-6)] = 0
    return shares / shares.sum()


@FEW
@given(seed=SEEDS, k=st.integers(1, 5))
def test_a_soft_vote_is_shared_as_the_network_says(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 2.5, (4, 6, 19)).astype(np.float32)
    scores = scores_from_logits(logits, np.arange(19, dtype=np.uint8), (32, 48), k)
    uv = rng.uniform([-0.5, -0.5], [47, 31], (5, 2))
    weight = rng.uniform(0.01, 0.5, 5).astype(np.float32)
    weight[3] = 0
    label = np.array([0, 3, 255, 1, 2], np.uint8)
    votes = np.zeros((5, 19))
    grid = (scores.classes, scores.steps, rest_steps(scores), STEPS_PER_NAT, scores.covered)
    size = (30, 44)
    voting.add_soft_votes(votes, *grid, size, uv, label, weight)
    for n in range(5):
        outside = uv[n, 0] >= 43.5 or uv[n, 1] >= 29.5
        if weight[n] == 0 or label[n] == 255 or outside:
            assert not votes[n].any()
        else:
            # A class whose share is e^-6 to rounding may be cut off or not.
            assert votes[n] / weight[n] == pytest.approx(naive_soft_vote(scores, *uv[n]), abs=0.003)
            assert votes[n].sum() == pytest.approx(weight[n], rel=1e-5)


@FEW
@given(seed=SEEDS)
def test_what_the_best_leave_over_is_shared_by_the_others(seed: int) -> None:
    logits = np.random.default_rng(seed).normal(0, 2, (3, 3, 19)).astype(np.float32)
    scores = scores_from_logits(logits, np.arange(19, dtype=np.uint8), (24, 24), 4)
    for best, steps, rest in zip(
        np.exp(scores.steps.reshape(-1, 4) / -32.0), scores.steps.reshape(-1, 4), rest_steps(scores).ravel(), strict=True
    ):
        share = max(1 - float(best.sum()), 1e-6) / 15
        assert rest == pytest.approx(max(steps[3], min(255.0, -32 * np.log(share))), abs=0.05)


def test_sure_scores_vote_as_hard_ones() -> None:
    classes = np.tile(np.array([7, 1], np.uint8), (3, 4, 1))
    steps = np.tile(np.array([0, 255], np.uint8), (3, 4, 1))
    uv, weight = np.array([[5.0, 5.0]]), np.array([0.25], np.float32)
    soft, hard = np.zeros((1, 19)), np.zeros((1, 19))
    rest, whole = np.full((3, 4), 255, np.float32), (24, 32)
    voting.add_soft_votes(soft, classes, steps, rest, 32, whole, whole, uv, np.zeros(1, np.uint8), weight)
    voting.add_hard_votes(hard, np.array([7], np.uint8), weight)
    assert np.array_equal(soft, hard)


def test_a_pixel_is_read_in_its_own_square_and_nowhere_else() -> None:
    labels = np.arange(CAMERA.height * CAMERA.width, dtype=np.int64).reshape(CAMERA.height, CAMERA.width).astype(np.uint8)
    uv = np.array([[3.49, 2.5], [3.51, 2.49], [-0.5, 0.0], [-0.51, 0.0], [99.49, 59.49], [99.5, 0.0], [np.nan, 1.0]])
    found = voting.read_labels(labels, uv)
    assert found.tolist() == [labels[3, 3], labels[2, 4], labels[0, 0], 255, labels[59, 99], 255, 255]


def test_votes_of_little_share_are_not_kept() -> None:
    votes = np.zeros((3, 19))
    votes[0, [2, 5]] = 1.0, 0.005
    votes[2, 18] = 0.25
    kinds, ids, sums = voting.sparse_votes(votes, 0.01)
    assert kinds.tolist() == [1, 0, 1]
    assert ids.tolist() == [2, 18]
    assert sums.tolist() == [1.0, 0.25]
    assert voting.sparse_votes(votes, 0.0)[0].tolist() == [2, 0, 1]


def test_votes_in_the_order_of_the_hosts_come_into_that_of_the_points() -> None:
    rng = np.random.default_rng(2)
    point, kinds = rng.permutation(30), rng.integers(0, 4, 30)
    ids, sums = rng.integers(0, 19, kinds.sum()).astype(np.uint8), rng.random(kinds.sum()).astype(np.float32)
    start = np.concatenate([[0], np.cumsum(kinds[np.argsort(point)])])
    ids_out, sums_out = np.empty_like(ids), np.empty_like(sums)
    voting.put_votes(point, start, ids, sums, ids_out, sums_out)
    came = np.concatenate([[0], np.cumsum(kinds)])
    for n, p in enumerate(point):
        assert ids_out[start[p] : start[p + 1]].tolist() == ids[came[n] : came[n + 1]].tolist()
        assert sums_out[start[p] : start[p + 1]].tolist() == sums[came[n] : came[n + 1]].tolist()
    assert start[-1] == len(ids_out) == kinds.sum()
