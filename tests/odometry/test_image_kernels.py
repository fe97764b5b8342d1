import numpy as np

from wayloom.odometry.kernels import images, selection
from wayloom.odometry.points.selection import gradient_thresholds, next_cell, select_candidates, spread_sample


def noise(shape: tuple[int, int] = (41, 53)) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)


def test_gradients_are_central_differences() -> None:
    image = noise().astype(np.float32)
    out = images.with_gradient(image)
    padded = np.pad(image, 1, mode="edge")
    np.testing.assert_array_equal(out[..., 0], image)
    np.testing.assert_array_equal(out[..., 1], 0.5 * (padded[1:-1, 2:] - padded[1:-1, :-2]))
    np.testing.assert_array_equal(out[..., 2], 0.5 * (padded[2:, 1:-1] - padded[:-2, 1:-1]))


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


def naive_selection(size, thresholds, block, cell, border, taken) -> list[tuple[int, int]]:
    h, w = size.shape[0] - border, size.shape[1] - border
    found: list[tuple[int, int]] = []

    def strongest(x0, x1, y0, y1, share):
        best, place = 0.0, None
        for y in range(y0, min(y1, h)):
            for x in range(x0, min(x1, w)):
                if size[y, x] > share * thresholds[y // block, x // block] and size[y, x] > best:
                    best, place = size[y, x], (x, y)
        return place

    def add(place):
        if not taken[place[1] // 8, place[0] // 8]:
            found.append(place)

    for y4 in range(border, h, 4 * cell):
        for x4 in range(border, w, 4 * cell):
            any4 = False
            for y2 in range(y4, min(y4 + 4 * cell, h), 2 * cell):
                for x2 in range(x4, min(x4 + 4 * cell, w), 2 * cell):
                    any2 = False
                    for y1 in range(y2, min(y2 + 2 * cell, h), cell):
                        for x1 in range(x2, min(x2 + 2 * cell, w), cell):
                            place = strongest(x1, x1 + cell, y1, y1 + cell, 1.0)
                            if place:
                                any2 = any4 = True
                                add(place)
                    place = strongest(x2, x2 + 2 * cell, y2, y2 + 2 * cell, 0.75)
                    if not any2 and place:
                        any4 = True
                        add(place)
            place = strongest(x4, x4 + 4 * cell, y4, y4 + 4 * cell, 0.5)
            if not any4 and place:
                add(place)
    return found


def test_selected_pixels_are_those_of_the_naive_search() -> None:
    rng = np.random.default_rng(2)
    size = (np.abs(rng.normal(scale=6, size=(90, 110))) * np.linspace(0.2, 2, 110)).astype(np.float32)
    thresholds = np.full((3, 4), 12, np.float32)
    taken = rng.random((12, 14)) < 0.2
    points = np.zeros((500, 2), np.int64)
    n = selection.select_pixels(size, thresholds, 32, 5, 6, taken, points)
    assert [tuple(p) for p in points[:n].tolist()] == naive_selection(size, thresholds, 32, 5, 6, taken)


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


def test_the_cell_grows_with_too_many_matches_and_shrinks_with_too_few() -> None:
    assert next_cell(12.0, 1000, 200) > 12 > next_cell(12.0, 50, 200)
    assert next_cell(3.0, 0, 200) == 3.0
