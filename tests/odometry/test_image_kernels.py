import numpy as np
import pytest

from wayloom.odometry.kernels import images, selection
from wayloom.odometry.points.selection import gradient_thresholds, next_cell, select_candidates, spread_sample

pytestmark = pytest.mark.kernels


def noise(shape: tuple[int, int] = (41, 53)) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("shape", [(41, 53), (2, 2), (40, 17)])
def test_a_halved_image_holds_the_exact_means_of_four_pixels(shape: tuple[int, int]) -> None:
    image, (h, w) = noise(shape), (shape[0] // 2, shape[1] // 2)
    expected = image[: 2 * h, : 2 * w].reshape(h, 2, w, 2).mean(axis=(1, 3), dtype=np.float64)
    np.testing.assert_array_equal(images.halved(image), expected)


def test_gradient_size_does_not_wrap_uint8_differences() -> None:
    image = noise()
    dy, dx = np.gradient(image.astype(float))
    expected = np.hypot(dx, dy)
    expected[[0, -1]] = expected[:, [0, -1]] = 0
    np.testing.assert_allclose(images.gradient_size(image), expected, rtol=1e-6)


def test_block_medians_are_lower_medians_of_whole_levels_over_every_second_pixel() -> None:
    size = np.abs(np.random.default_rng(1).normal(scale=40, size=(50, 70))).astype(np.float32)
    out = images.block_medians(size, 16)
    assert out.shape == (4, 5)
    for r in range(4):
        for c in range(5):
            block = np.minimum(np.floor(size[r * 16 : (r + 1) * 16 : 2, c * 16 : (c + 1) * 16 : 2]), 99)
            expected = np.sort(block.ravel())[(block.size + 1) // 2 - 1]
            assert out[r, c] == expected


def strongest_of_cells(size: np.ndarray, wanted: np.ndarray, border: int, edge: int) -> dict[tuple[int, int], tuple[int, int]]:
    """(column, row) of each cell of `edge` px that holds a wanted pixel, with its strongest (u, v); the first in rows of equals."""
    h, w = size.shape
    v, u = np.nonzero(wanted[border : h - border, border : w - border])
    order = np.lexsort((u, v, -size[v + border, u + border]))
    cells: dict[tuple[int, int], tuple[int, int]] = {}
    for k in order:
        cells.setdefault((int(u[k]) // edge, int(v[k]) // edge), (int(u[k]) + border, int(v[k]) + border))
    return cells


def naive_selection(size: np.ndarray, threshold_px: np.ndarray, cell: int, border: int, taken: np.ndarray) -> set[tuple[int, int]]:
    """By definition: every cell's strongest pixel over its threshold; of 2x2 cells without one the strongest over 3/4 of it; of 4x4
    cells without any of these the strongest over half of it; none at a taken place. threshold_px (h, w): of each pixel."""
    fine, middle, coarse = (
        strongest_of_cells(size, size > share * threshold_px, border, edge * cell)
        for share, edge in ((1.0, 1), (0.75, 2), (0.5, 4))
    )
    middle = {key: place for key, place in middle.items() if key not in {(a // 2, b // 2) for a, b in fine}}
    found = {(a // 4, b // 4) for a, b in fine} | {(a // 2, b // 2) for a, b in middle}
    coarse = {key: place for key, place in coarse.items() if key not in found}
    places = [*fine.values(), *middle.values(), *coarse.values()]
    return {(u, v) for u, v in places if not taken[v // selection.TAKEN_CELL, u // selection.TAKEN_CELL]}


@pytest.mark.parametrize(("cell", "border", "seed"), [(5, 6, 2), (3, 4, 3), (7, 9, 4)])
def test_selected_pixels_are_those_of_the_naive_search(cell: int, border: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = (np.abs(rng.normal(scale=6, size=(90, 110))) * np.linspace(0.2, 2, 110)).astype(np.float32)
    thresholds = rng.uniform(8, 16, (3, 4)).astype(np.float32)
    taken = rng.random((12, 14)) < 0.2
    points = np.zeros((2000, 2), np.int64)
    n = selection.select_pixels(size, thresholds, 32, cell, border, taken, points)
    expected = naive_selection(size, np.kron(thresholds, np.ones((32, 32), np.float32))[:90, :110], cell, border, taken)
    assert len(expected) > 40
    assert sorted(map(tuple, points[:n].tolist())) == sorted(expected)


def test_selected_pixels_come_in_row_order_of_groups_of_four_by_four_cells() -> None:
    size = np.abs(np.random.default_rng(5).normal(scale=6, size=(90, 110))).astype(np.float32)
    points = np.zeros((2000, 2), np.int64)
    n = selection.select_pixels(size, np.full((3, 4), 9, np.float32), 32, 5, 6, np.zeros((12, 14), np.bool_), points)
    row, column = (points[:n, 1] - 6) // 20, (points[:n, 0] - 6) // 20
    assert n > 40
    assert (np.diff(100 * row + column) >= 0).all()


def test_selection_stops_at_its_capacity() -> None:
    size = np.full((64, 64), 50, np.float32)
    points = np.zeros((7, 2), np.int64)
    assert selection.select_pixels(size, np.ones((2, 2), np.float32), 32, 4, 6, np.zeros((9, 9), np.bool_), points) == 7


def test_candidates_avoid_places_that_hold_a_point_and_the_border() -> None:
    image = noise((120, 160))
    taken = np.array([[80.0, 60.0]])
    pixels = select_candidates(image, taken, 6, 32, 7.0, 6)
    assert len(pixels) > 50
    assert pixels.min() >= 6
    assert (pixels < (154, 114)).all()
    assert not ((pixels // 8) == (10, 7)).all(axis=1).any()


def test_a_flat_image_has_no_candidates() -> None:
    assert len(select_candidates(np.full((80, 90), 77, np.uint8), np.zeros((0, 2)), 6, 32, 7.0, 6)) == 0


def test_thresholds_are_means_over_neighbouring_blocks() -> None:
    size = np.zeros((64, 96), np.float32)
    size[:, 32:64] = 30
    thresholds = gradient_thresholds(size, 32, 7.0)
    np.testing.assert_allclose(thresholds[0], [7 + 15, 7 + 10, 7 + 15])


def test_samples_are_spread_and_always_the_same() -> None:
    pixels = np.argwhere(np.ones((60, 80)))[:, ::-1].astype(np.int64)
    chosen = spread_sample(pixels, 400)
    np.testing.assert_array_equal(chosen, spread_sample(pixels, 400))
    assert len(np.unique(chosen)) == 400
    counts = np.histogram2d(*pixels[chosen].T, bins=(4, 4))[0]
    assert counts.min() > 10
    assert len(spread_sample(pixels[:5], 400)) == 5
    assert len(spread_sample(pixels, 0)) == 0


def test_of_equal_pixels_the_first_are_sampled() -> None:
    pixels = np.repeat(np.argwhere(np.ones((6, 8))).astype(np.int64), 5, axis=0)
    chosen = spread_sample(pixels, 33)
    assert len(chosen) == 33
    assert np.bincount(chosen // 5).max() == 5
    last = np.flatnonzero(np.bincount(chosen // 5) == 3)
    np.testing.assert_array_equal(chosen[chosen // 5 == last[0]] % 5, [0, 1, 2])


def test_the_cell_grows_with_too_many_matches_and_shrinks_with_too_few() -> None:
    assert next_cell(12.0, 1000, 200) > 12 > next_cell(12.0, 50, 200)
    assert next_cell(3.0, 0, 200) == 3.0
