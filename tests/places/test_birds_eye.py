"""Bird's-eye grids count what stands around a place, and are compared as a slow twin does it."""

import numpy as np
import pytest

from places.made_places import random_places
from wayloom.config.classes import CLASS_NAMES
from wayloom.places.birds_eye import (
    CELL_M,
    COARSER,
    KINDS,
    OCCUPIED,
    SHAPE,
    STEPS,
    birds_eye,
    ground_height,
    occupancy,
    packed,
    variants,
)
from wayloom.places.kernels.grids import best_overlap
from wayloom.places.surroundings import COMPARED, REACH_CELLS, Surroundings, weights
from wayloom.places.types import PlaceView
from wayloom.places.views import view_at


def random_grids(seed: int, count: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.where(rng.random((count, *SHAPE)) < 0.15, rng.integers(5, 45, (count, *SHAPE)), 0).astype(np.uint8)


def view() -> PlaceView:
    return view_at(random_places(11, keyframes=60), 30)


def test_a_grid_counts_the_points_of_each_kind_above_the_ground_cell_by_cell():
    place = view()
    points = np.zeros(SHAPE, int)
    for (x, y, z), label in zip(place.xyz.astype(float), place.label, strict=True):
        channel = [c for c, names in enumerate(KINDS) if CLASS_NAMES[label] in names]
        i, j = int(np.floor(y / CELL_M)) + SHAPE[1] // 2, int(np.floor(x / CELL_M)) + SHAPE[2] // 2
        if channel and 1.0 < z - ground_height(place) < 12.0 and 0 <= i < SHAPE[1] and 0 <= j < SHAPE[2]:
            points[channel[0], i, j] += 1
    assert points.sum() > 100
    np.testing.assert_array_equal(birds_eye(place), np.rint(STEPS * np.log1p(points)))


def test_occupancy_counts_points_of_cells_together_and_survives_packing():
    grids = random_grids(1)
    occupied = occupancy(grids)
    n, (c, a, b) = 2, (1, 5, 7)
    block = grids[n, c, COARSER * a : COARSER * (a + 1), COARSER * b : COARSER * (b + 1)].astype(float)
    assert occupied[n, c, a, b] == (np.expm1(block / STEPS).sum() > OCCUPIED - 0.5)
    assert packed(occupied).dtype == np.uint64
    assert sum(int(word).bit_count() for word in packed(occupied).ravel()) == occupied.sum()


def naive_overlap(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The largest sum over channels of common cells over the root of both counts, turned or not, moved by up to a cell."""
    best = 0.0
    for one in (theirs, theirs[:, ::-1, ::-1]):
        for da in (-1, 0, 1):
            for db in (-1, 0, 1):
                total = 0.0
                for c in range(len(ours)):
                    common = sum(
                        ours[c, i, j] and 0 <= i + da < ours.shape[1] and 0 <= j + db < ours.shape[2] and one[c, i + da, j + db]
                        for i in range(ours.shape[1])
                        for j in range(ours.shape[2])
                    )
                    total += common / np.sqrt(max(ours[c].sum(), 1) * max(theirs[c].sum(), 1))
                best = max(best, total)
    return best


@pytest.mark.kernels
def test_signatures_are_compared_as_the_slow_twin_does_it():
    occupied = occupancy(random_grids(2, count=6))
    rows, out = np.array([4, 1, 3]), np.empty(3, np.float32)
    best_overlap(packed(occupied), weights(occupied), variants(occupied[0]), weights(occupied)[0], rows, out)
    np.testing.assert_allclose(out, [naive_overlap(occupied[row], occupied[0]) for row in rows], rtol=1e-6)


def naive_correlation(ours: np.ndarray, theirs: np.ndarray) -> tuple[float, bool]:
    """The largest cross-correlation over shifts, each channel over its norms, turned or not."""
    best, is_turned = -1.0, False
    ours, theirs = ours.astype(float), theirs.astype(float)
    for turn in (False, True):
        one = theirs[:, ::-1, ::-1] if turn else theirs
        a, b = REACH_CELLS
        padded = np.pad(one, ((0, 0), (a, a), (b, b)))
        for da in range(2 * a + 1):
            for db in range(2 * b + 1):
                moved = padded[:, da : da + SHAPE[1], db : db + SHAPE[2]]
                total = sum(
                    (x * y).sum() / (np.linalg.norm(x) * np.linalg.norm(z))
                    for x, y, z in zip(ours, moved, one, strict=True)
                    if x.any() and z.any()
                )
                if total > best + 1e-12:
                    best, is_turned = total, turn
    return best / SHAPE[0], is_turned


@pytest.mark.kernels
@pytest.mark.parametrize("empty_channel", [False, True])
def test_grids_are_correlated_as_the_slow_twin_does_it(empty_channel):
    grids = random_grids(3, count=5)
    grids[2] = np.roll(grids[0][:, ::-1, ::-1], (2, -1), axis=(1, 2))
    if empty_channel:
        grids[:3, 2] = 0
    around = Surroundings()
    around.grow(5)
    around.put(np.arange(5, dtype=np.int32), grids)
    like, is_turned = around.alike(grids[0], np.array([1, 2, 4]))
    expected = [naive_correlation(grids[row], grids[0]) for row in (1, 2, 4)]
    np.testing.assert_allclose(like, [score for score, _ in expected], rtol=1e-12)
    assert is_turned.tolist() == [turn for _, turn in expected]
    assert is_turned[1]


def test_of_many_stations_those_with_the_likest_signatures_are_correlated():
    grids = random_grids(4, count=4 * COMPARED)
    around = Surroundings()
    around.grow(len(grids))
    around.put(np.arange(len(grids), dtype=np.int32), grids)
    like, _ = around.alike(grids[17], np.arange(len(grids)))
    assert COMPARED <= np.count_nonzero(like) < 2 * COMPARED
    assert like.argmax() == 17
    assert like[17] == pytest.approx(1.0)
