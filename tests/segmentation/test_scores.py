"""What is kept of a softmax: the likeliest classes, to a few percent, in little room."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayloom.segmentation.kernels.scores import best_scores, exponentiate
from wayloom.segmentation.scores import STEPS_PER_NAT, Scores, decode_scores, encode_scores, scores_from_logits

pytestmark = pytest.mark.kernels


def naive_scores(logits: np.ndarray, train_ids: np.ndarray, k: int) -> tuple[list[int], list[float]]:
    """The k best of one cell by the definition."""
    shares = np.exp(logits.astype(np.float64))
    shares /= shares.sum()
    ours = {c: sum(s for s, t in zip(shares, train_ids, strict=True) if t == c) for c in range(19)}
    best = sorted(ours, key=lambda c: (-ours[c], c))[:k]
    return best, [ours[c] for c in best]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 6), channels=st.integers(2, 30))
def test_the_kernel_agrees_with_its_twin(seed: int, k: int, channels: int) -> None:
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 4, (2, 3, channels)).astype(np.float32)
    train_ids = rng.choice([*range(19), 255], channels).astype(np.uint8)
    classes, steps = best_scores(logits, train_ids, 19, k, STEPS_PER_NAT)
    for v in range(2):
        for u in range(3):
            best, shares = naive_scores(logits[v, u], train_ids, k)
            known = np.flatnonzero(np.array(shares) > np.exp(-7.9))
            assert classes[v, u, known].tolist() == [best[i] for i in known.tolist()]
            assert np.exp(steps[v, u, known] / -32.0) == pytest.approx([shares[i] for i in known.tolist()], rel=0.5 / 32 + 1e-3)
    assert all(len(set(cell.tolist())) == k for cell in classes.reshape(-1, k))


def test_exponentials_are_right_to_the_last_digits() -> None:
    values = -np.concatenate([[0.0], np.random.default_rng(0).exponential(20, 1000), np.linspace(0, 699, 1001)])
    expected = np.exp(values)
    exponentiate(values)
    assert np.abs(values / expected - 1).max() < 4e-16
    lowest = np.array([-701.0, -1e30, -np.inf])
    exponentiate(lowest)
    assert (lowest < 1e-300).all()
    assert (lowest >= 0).all()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), gh=st.integers(1, 9), gw=st.integers(1, 40), k=st.integers(1, 5))
def test_scores_come_back_from_their_file(seed: int, gh: int, gw: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    kept = Scores(
        rng.integers(0, 19, (gh, gw, k)).astype(np.uint8), rng.integers(0, 256, (gh, gw, k)).astype(np.uint8), (8 * gh, 70_000)
    )
    back = decode_scores(encode_scores(kept))
    assert np.array_equal(back.classes, kept.classes)
    assert np.array_equal(back.steps, kept.steps)
    assert back.covered == kept.covered


def test_what_are_no_scores_is_refused() -> None:
    whole = encode_scores(scores_from_logits(np.zeros((4, 20, 19), np.float32), np.arange(19, dtype=np.uint8), (32, 160)))
    unknown_class = whole[:24] + bytes([19]) + whole[25:]
    picture = cv2.imencode(".png", np.full((9, 40), 7, np.uint8))[1].tobytes()
    for data in [b"", b"no scores", whole[:60], whole + b"more", unknown_class, picture]:
        with pytest.raises(ValueError, match="no scores"):
            decode_scores(data)
    assert decode_scores(whole).classes.shape == (4, 20, 4)


def test_the_scores_of_a_street_take_little_room() -> None:
    rng = np.random.default_rng(0)
    coarse = rng.normal(0, 6, (6, 22, 19)).astype(np.float32)
    logits = np.dstack([cv2.resize(coarse[..., c], (176, 48), interpolation=cv2.INTER_CUBIC) for c in range(19)])
    scores = scores_from_logits(np.ascontiguousarray(logits, np.float32), np.arange(19, dtype=np.uint8), (384, 1408))
    assert scores.classes.shape == (48, 176, 4)
    assert len(encode_scores(scores)) < 2 * scores.classes.size + 2000  # a byte for each class, one for each probability
