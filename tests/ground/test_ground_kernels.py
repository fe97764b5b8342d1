"""Kernels of the ground sheets against slow, plain twins."""

import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.ground.kernels.picture import add_colours, add_votes
from wayloom.ground.kernels.pieces import large_pieces, near
from wayloom.ground.kernels.plane import robust_plane
from wayloom.ground.kernels.samples import gather_heights
from wayloom.ground.kernels.standing import add_feet, stands
from wayloom.ground.kernels.surface import block_heights, cell_heights, smooth_blocks, smooth_surface

pytestmark = pytest.mark.kernels
CAMERA = np.array([60.0, 60.0, 19.5, 8.0])
PLANE = np.array([0.02, 0.7, -5.0])
BF, BIAS, REACH, CELL = 40.0, 0.1, 12.0, 0.25
LOW, SHAPE = np.array([-4.0, 0.0]), (44, 32)
FIRST_ROW = 12


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def T_sheet_cam():
    R = np.array([[1.0, 0.0, 0.0], [0.0, -np.sin(0.2), np.cos(0.2)], [0.0, -np.cos(0.2), -np.sin(0.2)]])
    return se3.from_rotation_translation(R, np.array([0.1, 0.2, 1.2]))


@pytest.fixture
def above(rng):
    out = rng.normal(0.0, 0.3, (28, 40)).astype(np.float32)
    out[rng.random(out.shape) < 0.2] = np.nan
    return out


def test_heights_are_gathered_as_a_plain_loop_gathers_them(rng, T_sheet_cam, above):
    group = rng.integers(0, 3, above.shape).astype(np.uint8)
    cells = 2 * SHAPE[0] * SHAPE[1]
    sums, counts = np.zeros((cells, 2)), np.zeros(cells, np.int32)
    key, height, variance = np.empty(above.size, np.int64), np.empty(above.size), np.empty(above.size)
    most = np.array([1.2, 0.3, 0.05])
    found = gather_heights(
        above, group, PLANE, FIRST_ROW, CAMERA, BF, BIAS, T_sheet_cam, REACH, most, LOW, CELL, np.array(SHAPE), sums, counts, key,
        height, variance,
    )  # fmt: skip
    expected: dict[int, list[tuple[float, float]]] = {}
    for (i, u), e in np.ndenumerate(above):
        disparity = PLANE @ [u, i + FIRST_ROW, 1.0] + float(e) - BIAS
        if group[i, u] == 0 or np.isnan(e) or disparity * REACH < BF:
            continue
        z = BF / disparity
        if abs(e) * most[0] > disparity * (most[1] + most[2] * z):
            continue
        ray = np.array([(u - CAMERA[2]) / CAMERA[0], (i + FIRST_ROW - CAMERA[3]) / CAMERA[1], 1.0])
        p = se3.transform(T_sheet_cam, z * ray[None])[0]
        c, r = np.floor((p[:2] - LOW) / CELL).astype(int)
        if 0 <= c < SHAPE[1] and 0 <= r < SHAPE[0]:
            lift = (p[2] - T_sheet_cam[2, 3]) / disparity
            expected.setdefault(2 * (r * SHAPE[1] + c) + int(group[i, u]) - 1, []).append((p[2], lift**2))
    assert found == len(expected) > 50
    for n in range(found):
        np.testing.assert_allclose([height[n], variance[n]], np.mean(expected[int(key[n])], axis=0), rtol=1e-9)
    assert not sums.any()
    assert not counts.any()


def robust(values, variances):
    mean, weights = np.median(values), 0.0
    for _ in range(2):
        weights = 1.0 / (variances + 0.25 * (values - mean) ** 2)
        mean = mean + (weights * (values - mean)).sum() / weights.sum()
    return mean, weights.sum()


def test_a_cell_takes_the_robust_mean_of_its_surer_group(rng):
    keys = rng.integers(0, 40, 300)
    values, variances = rng.normal(0.0, 0.05, 300), rng.uniform(1e-4, 4e-4, 300)
    values[::17] += 1.0
    height, information = np.zeros(20), np.zeros(20)
    group = np.zeros(20, np.uint8)
    cell_heights(keys, np.argsort(keys, kind="stable"), values, variances, height, information, group)
    for cell in range(20):
        options = [
            (*robust(values[keys == 2 * cell + g], variances[keys == 2 * cell + g]), g)
            for g in (0, 1)
            if (keys == 2 * cell + g).any()
        ]
        mean, weight, g = max(options, key=lambda option: option[1])
        np.testing.assert_allclose([height[cell], information[cell]], [mean, weight], rtol=1e-9)
        assert group[cell] == g + 1


def plane_twin(height, information, r, c, radius, step, start, prior=0.0, trust=0.0):
    """Level and sum of weights of the plane around a cell: least squares with the slopes' ridge, the prior a row of its own."""
    near = [
        (i, j) for i, j in np.argwhere(information > 0.0)
        if ((i - r) ** 2 + (j - c) ** 2) / (radius + 0.5) ** 2 < 1.0
    ]  # fmt: skip
    x, y = np.array([j - c for _, j in near] + [0.0]), np.array([i - r for i, _ in near] + [0.0])
    h, info = np.array([height[at] for at in near] + [prior]), np.array([information[at] for at in near] + [0.0])
    taper = 1.0 - (x * x + y * y) / (radius + 0.5) ** 2
    fit, total = np.array([start, 0.0, 0.0]), 0.0
    for _ in range(3):
        w = info * taper / (1.0 + ((h - fit[0] - fit[1] * x - fit[2] * y) / step) ** 2)
        w[-1] = trust
        total = w.sum()
        mx, my, mh = (w @ x) / total, (w @ y) / total, (w @ h) / total
        ridge = total * np.eye(2)
        # the ridge is on the slopes alone, about the window's middle: sum w x x + total, less the mean's part
        A = np.array([[w @ (x * x), w @ (x * y)], [w @ (x * y), w @ (y * y)]]) + ridge - total * np.outer([mx, my], [mx, my])
        slope = np.linalg.solve(A, [w @ (x * h) - total * mx * mh, w @ (y * h) - total * my * mh])
        fit = np.array([mh - slope @ [mx, my], *slope])
    return fit[0], total


def smooth(height, information, group, radius, step, broad=None, size=4, bend2=1e-4):
    """height, variance and filled of `smooth_surface`; broad : height and variance of the blocks, none of them if None."""
    out, variance, filled = np.zeros(height.shape), np.zeros(height.shape), np.zeros(height.shape, bool)
    blocks = (2, -(-height.shape[0] // size), -(-height.shape[1] // size))
    broad_height, broad_variance = (np.zeros(blocks), np.zeros(blocks)) if broad is None else broad
    smooth_surface(
        height, information, group, broad_height, broad_variance, size, bend2, radius, step, 0, len(height), out, variance, filled
    )  # fmt: skip
    return out, variance, filled


@pytest.fixture
def two_groups(rng):
    height = 0.02 * np.arange(18)[None] + rng.normal(0.0, 0.01, (14, 18))
    information = rng.uniform(1e3, 1e4, height.shape) * (rng.random(height.shape) < 0.8)
    return height, information, np.where(np.arange(18) < 9, 1, 2)[None].repeat(14, axis=0).astype(np.uint8)


def test_the_surface_is_a_plane_over_neighbours_of_the_group(two_groups):
    height, information, group = two_groups
    out, variance, filled = smooth(height, information, group, 3, 0.03)
    for r, c in np.argwhere(information > 0.0)[::7]:
        level, total = plane_twin(height, np.where(group == group[r, c], information, 0.0), r, c, 3, 0.03, height[r, c])
        np.testing.assert_allclose([out[r, c], variance[r, c]], [level, 1.0 / total], rtol=1e-7)
    assert not filled[information > 0.0].any()


def test_the_broad_surface_counts_as_a_measurement_of_the_cell(rng, two_groups):
    height, information, group = two_groups
    broad_height, broad_variance = rng.normal(0.1, 0.05, (2, 4, 5)), rng.uniform(1e-4, 1e-3, (2, 4, 5))
    broad_variance[:, :2, :2] = 0.0
    out, variance, _ = smooth(height, information, group, 3, 0.03, (broad_height, broad_variance), 4, 2e-4)
    held = 0
    for r, c in np.argwhere(information > 0.0)[::5]:
        g, total, prior, spread = group[r, c] - 1, 0.0, 0.0, 0.0
        for i, j in np.argwhere(broad_variance[group[r, c] - 1] > 0.0):
            apart = np.abs([(r + 0.5) / 4 - 0.5 - i, (c + 0.5) / 4 - 0.5 - j])
            w = np.prod(np.maximum(1.0 - apart, 0.0))
            total, prior, spread = total + w, prior + w * broad_height[g, i, j], spread + w * broad_variance[g, i, j]
        trust = 1.0 / (spread / total + 2e-4) if total > 0.25 else 0.0
        prior = prior / total if trust else 0.0
        held += trust > 0.0
        start = (information[r, c] * height[r, c] + trust * prior) / (information[r, c] + trust)
        level, weights = plane_twin(height, np.where(group == g + 1, information, 0.0), r, c, 3, 0.03, start, prior, trust)
        np.testing.assert_allclose([out[r, c], variance[r, c]], [level, 1.0 / weights], rtol=1e-7)
    assert 10 < held < len(np.argwhere(information > 0.0)[::5])


def test_blocks_are_robust_means_of_the_cells_of_each_group(two_groups):
    height, information, group = two_groups
    height[::5, ::4] += 0.3
    blocks, weights = np.zeros((2, 4, 5)), np.zeros((2, 4, 5))
    block_heights(height, information, group, 4, 0.05, blocks, weights)
    for g, r, c in np.ndindex(2, 4, 5):
        part = (slice(4 * r, 4 * r + 4), slice(4 * c, 4 * c + 4))
        own = (group[part] == g + 1) & (information[part] > 0.0)
        h, info = height[part][own], information[part][own]
        mean, w = 0.0, info
        for n in range(3):
            w = info / (1.0 + ((h - mean) / 0.05) ** 2) if n else info
            mean = (w @ h) / w.sum() if len(w) else 0.0
        np.testing.assert_allclose([blocks[g, r, c], weights[g, r, c]], [mean, w.sum()], rtol=1e-9)
    assert (weights[0, :, 3:] == 0.0).all()


def test_blocks_are_smoothed_by_planes_of_their_group(rng):
    height, information = rng.normal(0.0, 0.05, (2, 9, 8)), rng.uniform(1e3, 1e4, (2, 9, 8)) * (rng.random((2, 9, 8)) < 0.7)
    out, variance = np.zeros(height.shape), np.zeros(height.shape)
    smooth_blocks(height, information, 3, 0.05, out, variance)
    for g, r, c in np.argwhere(information > 0.0)[::5]:
        window = (g, slice(max(r - 3, 0), r + 4), slice(max(c - 3, 0), c + 4))
        start = np.average(height[window], weights=information[window])
        level, total = plane_twin(height[g], information[g], r, c, 3, 0.05, start)
        np.testing.assert_allclose([out[g, r, c], variance[g, r, c]], [level, 1.0 / total], rtol=1e-7)
    assert (variance[information == 0.0] == 0.0).all()


def test_only_cells_that_are_enclosed_are_filled():
    information = np.zeros((11, 11))
    information[3:8, 3:8] = 1e4
    information[5, 5] = 0.0
    out, variance, filled = smooth(np.full((11, 11), 0.5), information, np.ones((11, 11), np.uint8), 4, 0.03)
    assert filled[5, 5]
    np.testing.assert_allclose(out[5, 5], 0.5)
    assert (variance[[0, 0, 10, 10], [0, 10, 0, 10]] == 0.0).all()
    assert not filled[3:8, 0].any()


def seen(T_cam_sheet, point):
    p = se3.transform(T_cam_sheet, point[None])[0]
    return (CAMERA[0] * p[0] / p[2] + CAMERA[2], CAMERA[1] * p[1] / p[2] + CAMERA[3], p[2]) if p[2] > 0.1 else (-1.0, -1.0, p[2])


def hidden(above, u, v, depth, slack):
    i, j = round(v) - FIRST_ROW, round(u)
    if i < 0 or np.isnan(above[i, j]):
        return False
    measured = PLANE @ [j, i + FIRST_ROW, 1.0] + float(above[i, j]) - BIAS
    return abs(measured - BF / depth) > slack * BF / depth + 1.0


def test_votes_are_inverse_depths_of_the_views_that_see_the_cell(rng, T_sheet_cam, above):
    height = rng.normal(0.0, 0.02, SHAPE)
    height[rng.random(SHAPE) < 0.2] = np.nan
    label = rng.integers(0, 5, (40, 40)).astype(np.uint8)
    kind_of = np.full(256, -1, np.int8)
    kind_of[:4] = [0, 1, 2, 3]
    T_cam_sheet = se3.inverse(T_sheet_cam)
    votes, expected = np.zeros((*SHAPE, 4), np.float32), np.zeros((*SHAPE, 4))
    window = np.array([2, SHAPE[0], 0, SHAPE[1] - 3])
    add_votes(height, LOW, CELL, window, label, kind_of, above, FIRST_ROW, PLANE, CAMERA, BF, BIAS, T_cam_sheet, REACH, 0.2, votes)
    for r in range(2, SHAPE[0]):
        for c in range(SHAPE[1] - 3):
            u, v, depth = seen(T_cam_sheet, np.array([LOW[0] + (c + 0.5) * CELL, LOW[1] + (r + 0.5) * CELL, height[r, c]]))
            if np.isnan(height[r, c]) or depth > REACH or not (0 <= u <= 39 and 0 <= v <= 39):
                continue
            kind = kind_of[label[round(v), round(u)]]
            if kind >= 0 and not hidden(above, u, v, depth, 0.2):
                expected[r, c, kind] += 1.0 / depth
    assert (expected > 0.0).sum() > 30
    np.testing.assert_allclose(votes, expected, rtol=1e-5)


def test_a_pixel_that_may_not_be_shown_gives_no_colour_and_others_their_own(rng, T_sheet_cam, above):
    height = np.zeros(SHAPE)
    image = rng.integers(0, 200, (28, 40, 3)).astype(np.uint8)
    shown = np.ones((28, 40), np.float32)
    shown[:, :20] = 0.0
    T_cam_sheet = se3.inverse(T_sheet_cam)
    fine = (2 * SHAPE[0], 2 * SHAPE[1])
    colour, weight, sharp = np.zeros((*fine, 3), np.float32), np.zeros(fine, np.float32), np.zeros(fine, np.float32)
    window = np.array([0, SHAPE[0], 0, SHAPE[1]])
    add_colours(
        height, LOW, CELL, window, image, FIRST_ROW, 1.5, 10.0, 0.4, shown, above, FIRST_ROW, PLANE, CAMERA, BF, BIAS,
        T_cam_sheet, REACH, 100.0, 2.0, colour, weight, sharp,
    )  # fmt: skip
    count = 0
    for row in range(fine[0]):
        for column in range(fine[1]):
            point = np.array([LOW[0] + (column + 0.5) * CELL / 2, LOW[1] + (row + 0.5) * CELL / 2, 0.0])
            u, v, depth = seen(T_cam_sheet, point)
            inside = depth <= REACH and 2 <= u <= 37 and FIRST_ROW + 2 <= v <= 37 and round(u) >= 20
            assert (weight[row, column] > 0.0) == inside
            if not inside:
                continue
            count += 1
            i, j = int(v - FIRST_ROW), int(u)
            fv, fu = v - FIRST_ROW - i, u - j
            patch = image[i : i + 2, j : j + 2].astype(float)
            value = (1 - fv) * ((1 - fu) * patch[0, 0] + fu * patch[0, 1]) + fv * ((1 - fu) * patch[1, 0] + fu * patch[1, 1])
            r = np.array([(u - CAMERA[2]) / CAMERA[0], (v - CAMERA[3]) / CAMERA[1]])
            lit = (1.5 * value + 10.0) * (1.0 + r @ r) ** 0.4
            np.testing.assert_allclose(colour[row, column] / weight[row, column], lit, rtol=1e-3)
            steps = [np.array(seen(T_cam_sheet, point + d)[:2]) for d in (np.array([1e-5, 0, 0]), np.array([0, 1e-5, 0]))]
            J = np.column_stack([(s - [u, v]) / 1e-5 for s in steps])
            smallest = np.linalg.svd(J, compute_uv=False)[1]
            np.testing.assert_allclose(sharp[row, column] / weight[row, column], smallest, rtol=1e-2)
    assert count > 100


def test_pixels_stand_that_are_higher_than_the_surface_where_their_depth_puts_them(rng, T_sheet_cam, above):
    height = rng.normal(0.0, 0.05, SHAPE)
    height[rng.random(SHAPE) < 0.3] = np.nan
    least, unknown, noise, camera_height, above = 0.02, 0.05, 0.1, 1.2, 3.0 * above
    out, foot = np.zeros(above.shape, bool), np.zeros(above.shape, np.int32)
    stands(
        above, FIRST_ROW, PLANE, CAMERA, BF, BIAS, camera_height, T_sheet_cam, REACH, height, LOW, CELL, least, unknown, noise, out,
        foot,
    )  # fmt: skip
    kinds = np.zeros((2, 2), int)
    for (i, u), e in np.ndenumerate(above):
        disparity = PLANE @ [u, i + FIRST_ROW, 1.0] + float(e) - BIAS
        if np.isnan(e) or disparity * REACH < BF:
            assert not out[i, u]
            continue
        ray = np.array([(u - CAMERA[2]) / CAMERA[0], (i + FIRST_ROW - CAMERA[3]) / CAMERA[1], 1.0])
        p = se3.transform(T_sheet_cam, BF / disparity * ray[None])[0]
        c, r = np.floor((p[:2] - LOW) / CELL).astype(int)
        known = 0 <= c < SHAPE[1] and 0 <= r < SHAPE[0] and not np.isnan(height[r, c])
        margin = noise * camera_height / disparity
        rise = p[2] - height[r, c] - least if known else float(e) * camera_height / disparity - unknown
        assert out[i, u] == (rise > margin)
        limit = (least if known else unknown) + margin
        assert foot[i, u] == (np.ceil(limit * CAMERA[1] * disparity / BF) if rise > margin else 0)
        kinds[int(known), int(rise > margin)] += 1
    assert (kinds > 8).all()


def test_what_stands_reaches_down_to_its_feet(rng):
    standing = rng.random((14, 20)) < 0.15
    foot = np.where(standing, rng.integers(0, 5, standing.shape), 0).astype(np.int32)
    out = np.zeros(standing.shape, bool)
    add_feet(standing, foot, out)
    expected = standing.copy()
    for i, j in np.argwhere(standing):
        for k in range(i + 1, min(i + 1 + foot[i, j], 14)):
            if standing[k, j]:
                break
            expected[k, j] = True
    assert (expected & ~standing).sum() > 20
    np.testing.assert_array_equal(out, expected)


def test_the_plane_of_disparities_is_that_of_weighted_least_squares(rng):
    u, v = rng.uniform(0.0, 300.0, 400), rng.uniform(40.0, 90.0, 400)
    disparity = 0.01 * u + 0.6 * v - 20.0 + rng.normal(0.0, 0.1, 400)
    disparity[::9] += 4.0
    A, weight, scales = np.column_stack([u, v, np.ones(400)]), np.ones(400), np.geomspace(4.0, 0.4, 8)
    for scale in scales:
        x = np.linalg.lstsq(A * np.sqrt(weight)[:, None], disparity * np.sqrt(weight))[0]
        weight = 1.0 / (1.0 + ((A @ x - disparity) / scale) ** 2)
    np.testing.assert_allclose(robust_plane(u, v, disparity, scales), x, rtol=1e-7)
    np.testing.assert_allclose(x, [0.01, 0.6, -20.0], rtol=0.05)


def test_pixels_of_one_row_have_no_plane():
    u = np.arange(50.0)
    assert np.isnan(robust_plane(u, np.full(50, 7.0), 0.1 * u, np.array([4.0, 1.0]))).all()


def test_pieces_are_large_by_their_own_pixels(rng):
    for share in (0.1, 0.4, 0.6):
        marked = rng.random((30, 41)) < share
        out, label = np.zeros(marked.shape, np.bool_), np.where(marked, 1 + np.arange(marked.size).reshape(marked.shape), 0)
        while True:
            padded = np.pad(label, 1)
            around = np.max([label, padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0)
            if (np.where(marked, around, 0) == label).all():
                break
            label = np.where(marked, around, 0)
        large_pieces(marked, 5.0, out)
        np.testing.assert_array_equal(out, marked & (np.bincount(label.ravel())[label] >= 5))


def test_what_is_near_lies_within_the_disc_of_a_marked_pixel(rng):
    marked = (rng.random((20, 31)) < 0.02).astype(np.uint8)
    widths, out = (0, 2, 3, 2, 0), np.zeros(marked.shape, np.uint8)
    near(marked, np.array(widths, np.uint16), out)
    for (i, j), value in np.ndenumerate(out):
        rows = range(max(i - 2, 0), min(i + 3, 20))
        assert value == any(marked[r, max(j - widths[r - i + 2], 0) : j + widths[r - i + 2] + 1].any() for r in rows)
