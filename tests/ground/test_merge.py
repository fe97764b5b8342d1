"""The merge of ground sheets: what it shows, what it averages, and that neither order nor squares change a bit."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.made_sheets import DASH_WIDE_M, SURE, Street, cut
from wayloom.errors import InputError
from wayloom.ground.balance import balance_fields, box_sum
from wayloom.ground.ground_map import NO_HEIGHT, GroundFile, GroundMap, decode_ground
from wayloom.ground.kernels import merging
from wayloom.ground.kernels.detail import LEAST_STEP, block_detail, step_agreement
from wayloom.ground.kernels.resampling import colour_of, place
from wayloom.ground.levelling import REACH_BLOCKS, seam_gains
from wayloom.ground.merge import merge_sheets
from wayloom.ground.placed_sheet import PlacedSheet, kernel_arrays
from wayloom.ground.sheet import CELL_M, PIXEL_M

STREET = Street()
LOW, EDGE_M = np.zeros(2), 64.0


def drive(name: str, start: float = -20.0, pieces: int = 3, street: Street = STREET, **how: object) -> list[PlacedSheet]:
    """Sheets of 42 m, each from the end of the one before."""
    seed, t_s = int(str(how.pop("seed", 0))), int(str(how.pop("t_s", 100)))
    ends = [(start + 40.0 * k, start + 40.0 * k + 42.0) for k in range(pieces)]
    return [cut(street, *one, name * 64, seed=seed + k, t_s=t_s + 10 * k, **how) for k, one in enumerate(ends)]  # type: ignore[arg-type]


def merged(sheets: list[PlacedSheet], low: NDArray[np.float64] = LOW, edge_m: float = EDGE_M) -> GroundMap:
    found = merge_sheets(sheets, low, edge_m)
    assert found is not None
    return found


def places(count: int, step_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    middle = (np.arange(count) + 0.5) * step_m
    x, y = np.meshgrid(middle, middle)
    return x, y


def height_error_mm(made: GroundMap, street: Street = STREET) -> NDArray[np.float64]:
    """Of the known cells away from kerbs."""
    x, y = places(len(made.height_mm), CELL_M)
    flat = (made.height_mm != NO_HEIGHT) & (np.abs(np.abs(y - 30.0) - 4.0) > 0.2)
    return np.asarray(made.height_mm[flat] - 1000.0 * street.height(x, y)[flat])


def dash_width_m(made: GroundMap, x_from_m: float, x_to_m: float) -> float:
    """Mean width of the paint, over the columns of a dash; how bright asphalt and paint are is told by the asphalt around."""
    columns = slice(round(x_from_m / PIXEL_M), round(x_to_m / PIXEL_M))
    strip = made.colour[round(28.5 / PIXEL_M) : round(31.5 / PIXEL_M), columns, 0].astype(float)
    asphalt = np.median(strip)
    paint = np.clip((strip / asphalt - 1.0) / (220.0 / 95.0 - 1.0), 0.0, 1.0)
    return float(np.where(paint > 0.25, paint, 0.0).sum(axis=0).mean() * PIXEL_M)


def test_one_drive_lies_where_it_was_at_its_own_colours() -> None:
    made = merged(drive("a"))
    x, y = places(1280, PIXEL_M)
    seen, calm = made.shown > 0, np.abs(np.abs(y - 30.0) - 4.0) > 0.2
    assert seen[(np.abs(y - 30.0) < 8.9)].mean() > 0.995
    assert not seen[np.abs(y - 30.0) > 9.2].any()
    error = made.colour[..., 0].astype(float) - STREET.grey(x, y)
    assert np.median(np.abs(error[seen & calm & (np.abs(y - 30.0) > 0.2)])) < 3.0
    assert np.percentile(np.abs(height_error_mm(made)), 95) < 6.0
    kerb = made.height_mm[np.abs(np.arange(640) * CELL_M - 25.7) < 0.05].mean() - made.height_mm[260:262].mean()
    assert kerb == pytest.approx(120.0, abs=8.0)
    assert (made.label[290:310] == 0).all()
    assert (made.label[230:255] == 1).all()


def test_neither_order_nor_repetition_changes_a_byte() -> None:
    sheets = drive("a") + drive("b", t_s=9000, gain=0.7, believed=(0.02, 0.03, 0.05), seed=20, yaw=3.3)
    first = merged(sheets).encoded()
    assert merged([*reversed(sheets), sheets[1]]).encoded() == first
    assert merged(drive("a")).encoded() != first


def test_the_squares_of_a_map_are_pieces_of_one_large_square() -> None:
    """Cells and pixels; numbers of sheets count those of their own square."""
    sheets = drive("a", -60.0, 6) + drive("b", -10.0, 2, t_s=9000, gain=0.7, believed=(0.02, 0.03, 0.05), seed=20, yaw=3.3)
    whole = merged(sheets, LOW, 128.0)
    for east in (0, 1):
        part = merged(sheets, np.array([64.0 * east, 0.0]), 64.0)
        for name in ("height_mm", "sigma_mm", "own_sigma_mm", "votes", "looks", "colour", "sharpness"):
            all_of_it = getattr(whole, name)
            n = all_of_it.shape[0] // 2
            np.testing.assert_array_equal(getattr(part, name), all_of_it[:n, east * n : (east + 1) * n], err_msg=name)


def test_drives_in_opposite_directions_leave_no_double_edge() -> None:
    """Five centimetres apart, in another light: each dash comes from one of them."""
    alone = drive("a")
    both = alone + drive("b", t_s=9000, gain=0.8, believed=(0.03, 0.05, 0.03), seed=20, yaw=3.3, sharpness=58)
    width, widths = dash_width_m(merged(alone), 12.5, 14.5), dash_width_m(merged(both), 12.5, 14.5)
    assert width == pytest.approx(DASH_WIDE_M, abs=0.03)
    assert widths == pytest.approx(width, rel=0.10)


def test_an_end_of_a_darker_drive_leaves_no_step() -> None:
    """The darker one, sharper and so shown, ends at x = 33 in the middle of the square."""
    bright, dark = drive("a"), drive("b", -49.0, 2, gain=0.7, sharpness=90, seed=20, t_s=9000)
    made = merged(bright + dark)
    assert len(np.unique(made.shown[600])) > 1
    x, y = places(1280, PIXEL_M)
    share = made.colour[..., 0] / STREET.grey(x, y)
    rows = slice(round(26.8 / PIXEL_M), round(29.5 / PIXEL_M))
    column = share[rows].mean(axis=0)
    steps = np.abs(np.diff(column.reshape(-1, 20).mean(axis=1)))
    assert column[:200].mean() == pytest.approx(0.85, abs=0.06)
    assert column[-200:].mean() == pytest.approx(1.0, abs=0.03)
    assert steps.max() < 0.04


def test_heights_of_drives_meet_in_the_middle_and_the_better_placed_counts_more() -> None:
    low, high = drive("a"), drive("b", believed=(0.0, 0.0, 0.10), seed=20, t_s=9000)
    assert np.median(height_error_mm(merged(low + high))) == pytest.approx(50.0, abs=4.0)
    vague = SURE * 400.0
    high = drive("b", believed=(0.0, 0.0, 0.10), seed=20, t_s=9000, covariance=vague)
    made = merged(low + high)
    assert abs(np.median(height_error_mm(made))) < 4.0
    assert np.percentile(np.abs(height_error_mm(made)), 95) < 6.0
    known = made.sigma_mm[made.height_mm != NO_HEIGHT]
    assert 18 <= np.median(known) <= 24


def test_the_newest_look_is_shown_where_the_ground_has_changed() -> None:
    """Asphalt laid anew, darker, its grain its own: by the newest drive, though it saw less sharply, and only there."""
    patched = replace(STREET, patch=(20.0, 32.0, 26.0, 34.0))
    old, new = drive("a", sharpness=80), drive("b", street=patched, sharpness=50, t_s=9000, seed=20)
    made = merged(old + new)
    first_new = 1 + [drive_id for drive_id, _ in made.sheets].index("b" * 64)
    inside = made.shown[round(28 / PIXEL_M) : round(32 / PIXEL_M), round(22 / PIXEL_M) : round(30 / PIXEL_M)]
    assert (inside >= first_new).all()
    outside = made.shown[round(27 / PIXEL_M) : round(33 / PIXEL_M), round(45 / PIXEL_M) : round(60 / PIXEL_M)]
    assert (outside < first_new).all()
    assert made.looks[300, 260] == 1  # the old ones say nothing there any more
    assert made.looks[300, 520] == 2


def test_the_newest_height_counts_where_the_ground_was_dug_away() -> None:
    dug = replace(STREET, patch=(20.0, 32.0, 26.0, 34.0), darker=0.0, step_m=0.15)
    made = merged(drive("a", sharpness=80) + drive("b", street=dug, sharpness=50, t_s=9000, seed=20))
    x, y = places(640, CELL_M)
    deep = (x > 22) & (x < 30) & (y > 28) & (y < 32)
    assert np.abs(made.height_mm[deep] - 1000.0 * dug.height(x, y)[deep]).mean() < 25.0


@pytest.mark.parametrize("newest_is_shady", [True, False])
@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_of_one_ground_in_two_lights_the_brighter_is_shown_and_both_tell_of_it(newest_is_shady: bool, gain: float) -> None:
    """Ten metres of shadow on the sharper drive, newer or older, in its own exposure: gone from the road, without a step."""
    lit = drive("a", -32.0, sharpness=50, t_s=100 if newest_is_shady else 9000)
    shady = drive("b", -32.0, shade=(24.0, 34.0), sharpness=80, t_s=9000 if newest_is_shady else 100, seed=20, gain=gain)
    made = merged(lit + shady)
    first_shady = 1 + [drive_id for drive_id, _ in made.sheets].index("b" * 64)
    road, (x, y) = slice(round(26.8 / PIXEL_M), round(29.5 / PIXEL_M)), places(1280, PIXEL_M)
    assert (made.shown[road, round(24 / PIXEL_M) : round(34 / PIXEL_M)] < first_shady).all()
    assert (made.shown[road, round(40 / PIXEL_M) : round(60 / PIXEL_M)] >= first_shady).all()
    share = (made.colour[..., 0] / STREET.grey(x, y))[road].mean(axis=0).reshape(-1, 20).mean(axis=1)
    assert np.abs(np.diff(share)).max() < 0.03
    assert (made.looks[270:295, 250:350] == 2).all()


def test_grey_sheets_make_grey_ground_and_with_colour_they_are_grey_in_it() -> None:
    grey = drive("a", channels=1)
    assert merged(grey).colour.shape[2] == 1
    mixed = merged(grey + drive("b", 22.0, 2, seed=20, t_s=9000))
    assert mixed.colour.shape[2] == 3
    assert (mixed.colour[..., 0] == mixed.colour[..., 1]).all()


def test_where_no_sheet_lies_there_is_no_ground() -> None:
    assert merge_sheets([], LOW, EDGE_M) is None
    assert merge_sheets(drive("a"), np.array([0.0, 640.0]), EDGE_M) is None
    with pytest.raises(ValueError, match="grid"):
        merge_sheets(drive("a"), np.array([0.05, 0.0]), EDGE_M)


def test_ground_reads_back_as_it_was_written_and_damage_is_named() -> None:
    made = merged(drive("a", pieces=1) + drive("b", pieces=1, t_s=9000, seed=20))
    back = decode_ground(made.encoded())
    for one in fields(GroundMap):
        np.testing.assert_array_equal(getattr(back, one.name), getattr(made, one.name), err_msg=one.name)
    assert GroundFile(made.encoded()).raster("colour").shape == (1280, 1280, 3)
    for bad in (made.encoded()[:-1], b"WLGROUND" + made.encoded()[8:], b""):
        with pytest.raises(InputError, match=r"a\.ground.*stitched anew"):
            decode_ground(bad, "a.ground")


@pytest.mark.parametrize("reach", [0, 1, 3])
def test_sums_over_boxes_are_those_of_plain_loops(reach: int) -> None:
    values = np.random.default_rng(0).integers(-50, 50, (2, 6, 7))
    wanted = np.zeros_like(values)
    for i in range(6):
        for j in range(7):
            wanted[:, i, j] = values[:, max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1].sum(axis=(1, 2))
    np.testing.assert_array_equal(box_sum(values, reach), wanted)


def test_one_sheet_alone_is_left_as_it_is() -> None:
    (sheet,) = drive("a", pieces=1)
    sums = np.zeros((1, 32, 32, 8), np.int64)
    merging.block_sums(kernel_arrays(sheet.read(), sheet.T_map_submap), np.array([0, 24]), sums[0])
    field = balance_fields(sums, np.array([0.02]))
    assert field.shape == (1, 4, 8, 8)
    assert (field[:, :3] == 1.0).all()
    assert (field[:, 3] == 0.0).all()


@pytest.mark.kernels
def test_painting_is_that_of_a_plain_loop() -> None:
    """A few blocks at a sheet's border, with a field and gains that are not flat."""
    (sheet,) = drive("a", 2.0, pieces=1)
    held = kernel_arrays(sheet.read(), sheet.T_map_submap)
    corner, first = np.array([1, 36]), np.array([-2, 7])
    field = np.ones((4, 6, 6)) * np.linspace(0.8, 1.1, 6)
    wanted, level = np.array([[True, True], [False, True]]), np.random.default_rng(2).uniform(0.8, 1.2, (4, 4, 3))
    out = np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint8), np.zeros((32, 32), np.uint16)
    merging.paint(held, 7, wanted, corner, field, first, level, out)
    naive = painted_naively(sheet, 7, wanted, corner, field, first, level)
    for one, other in zip(out, naive, strict=True):
        assert np.abs(one.astype(int) - other.astype(int)).max() <= 1
    np.testing.assert_array_equal(out[2], naive[2])
    assert 0 < (out[2] > 0).sum() < 3 * 256


def painted_naively(placed, number, wanted, corner, field, first, level):  # type: ignore[no-untyped-def]
    """Each pixel by itself, with numpy: the surface is looked for along the map's vertical in small steps."""
    sheet = placed.read()
    T = placed.T_map_submap @ sheet.T_submap_sheet
    colours, sharp, shown = np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint8), np.zeros((32, 32), np.uint16)
    middle = np.median(sheet.height[np.isfinite(sheet.height)])
    for row in range(32):
        for column in range(32):
            if not wanted[row // 16, column // 16]:
                continue
            x, y = (np.array([column, row]) + 16 * corner + 0.5) * PIXEL_M
            h = middle
            for _ in range(2):
                uv = np.linalg.solve(T[:2, :2], np.array([x, y]) - T[:2, 3] - T[:2, 2] * h)
                c, r = np.floor(uv / CELL_M).astype(int) - sheet.corner
                inside = 0 <= r < len(sheet.height) and 0 <= c < sheet.height.shape[1]
                h = sheet.height[r, c] if inside and np.isfinite(sheet.height[r, c]) else h
            px, py = uv / PIXEL_M - 2 * sheet.corner - 0.5
            c, r = int(np.floor(px + 0.5)), int(np.floor(py + 0.5))
            if not (0 <= r < len(sheet.sharpness) and 0 <= c < sheet.sharpness.shape[1]) or sheet.sharpness[r, c] == 0:
                continue
            total, weight = np.zeros(3), 0.0
            for rr in (int(np.floor(py)), int(np.floor(py)) + 1):
                for cc in (int(np.floor(px)), int(np.floor(px)) + 1):
                    if sheet.sharpness[rr, cc]:
                        w = (1 - abs(px - cc)) * (1 - abs(py - rr))
                        total, weight = total + w * sheet.colour[rr, cc], weight + w
            tx, ty = x / 3.2 - first[0] - 0.5, y / 3.2 - first[1] - 0.5
            gain = np.interp(tx, np.arange(6), field[0, 0])
            assert 0 <= tx < 5
            assert 0 <= ty < 5
            at = np.array([row + 0.5, column + 0.5]) / 16.0 + 0.5
            (i, j), (b, a) = at.astype(int), at % 1.0
            near = level[i : i + 2, j : j + 2] * (np.array([1 - b, b])[:, None] * np.array([1 - a, a]))[..., None]
            colours[row, column] = np.rint(np.clip(near.sum(axis=(0, 1)) * gain * total / weight, 0, 255))
            sharp[row, column], shown[row, column] = sheet.sharpness[r, c], number
    return colours, sharp, shown


@pytest.mark.kernels
def test_detail_and_its_agreement_are_those_of_plain_loops() -> None:
    """Means of 20 cm of a level sheet; steps counted pair by pair."""
    (sheet,) = drive("a", 2.0, pieces=1)
    held, first = kernel_arrays(sheet.read(), sheet.T_map_submap), np.array([1, 36])
    out = np.zeros((3, 3, 4, 4), np.int16)
    block_detail(held, first, out)
    colour = np.zeros(3)
    for (i, j, a, b), told in np.ndenumerate(out):
        points = [
            ((first[0] + j) * 0.8 + (b + p) * 0.2, (first[1] + i) * 0.8 + (a + q) * 0.2) for p in (0.25, 0.75) for q in (0.25, 0.75)
        ]
        seen = [(colour_of(held, *place(held, x, y)[:2], colour) > 0, colour.mean()) for x, y in points]
        wanted = np.rint(4.0 * sum(grey for _, grey in seen)) if all(there for there, _ in seen) else -1
        assert abs(told - wanted) <= 1
    assert (out >= 0).any()
    rng = np.random.default_rng(3)
    one, other = rng.integers(-1, 60, (2, 3, 3, 4, 4)).astype(np.int16)
    counts = np.zeros((2, 3, 3), np.int64)
    step_agreement(one, other, counts)
    for i, j in np.ndindex(3, 3):
        pairs = [((a, b), (a, b + 1)) for a in range(4) for b in range(3)] + [
            ((a, b), (a + 1, b)) for a in range(3) for b in range(4)
        ]
        signs = []
        for low, high in pairs:
            values = [int(of[i, j][at]) for of in (one, other) for at in (low, high)]
            steps = values[1] - values[0], values[3] - values[2]
            if min(values) >= 0 and min(map(abs, steps)) >= LEAST_STEP:
                signs.append(np.sign(steps[0] * steps[1]))
        assert counts[:, i, j].tolist() == [sum(signs), len(signs)]


def test_patches_that_differ_meet_in_between_and_far_from_their_border_stay_as_they_are() -> None:
    colour = np.full((2, 4, 24, 3), 100.0)
    colour[1] = 120.0
    seen, shown = np.ones((2, 4, 24), np.bool_), np.where(np.arange(24) < 12, 0, 1)[None].repeat(4, axis=0)
    gain = seam_gains(colour, seen, seen, shown)
    row = (np.where(shown[..., None] == 0, gain[0], gain[1]) * np.where(shown == 0, 100.0, 120.0)[..., None])[2, :, 0]
    assert (row[: 12 - REACH_BLOCKS] == 100.0).all()
    assert (row[12 + REACH_BLOCKS :] == 120.0).all()
    assert (np.diff(row) >= 0.0).all()
    assert np.diff(row).max() < 5.0  # of 20 in one step
    nothing = seam_gains(colour, np.zeros_like(seen), seen, shown)
    assert (nothing == 1.0).all()
