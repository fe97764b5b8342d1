"""Ground sheets: bytes there and back, damage, shapes."""

from dataclasses import fields, replace

import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.ground.sheet import NO_HEIGHT, GroundSheet, decode_sheet


def a_sheet(channels: int = 3, rows: int = 7, columns: int = 5) -> GroundSheet:
    rng = np.random.default_rng(3)
    height = rng.integers(-2000, 2000, (rows, columns)).astype(np.int16)
    height[:1, :1] = NO_HEIGHT
    return GroundSheet(
        submap="ab" * 32,
        T_submap_sheet=np.eye(4),
        corner=np.array([-3, 12], np.int32),
        t_ns=np.array([5, 9], np.int64),
        height_mm=height,
        sigma_mm=rng.integers(0, 256, (rows, columns)).astype(np.uint8),
        votes=rng.integers(0, 65536, (rows, columns, 3)).astype(np.uint16),
        colour=rng.integers(0, 256, (2 * rows, 2 * columns, channels)).astype(np.uint8),
        sharpness=rng.integers(0, 256, (2 * rows, 2 * columns)).astype(np.uint8),
    )


@pytest.mark.parametrize("channels", [1, 3])
def test_a_sheet_reads_back_as_it_was_written(channels: int) -> None:
    sheet = a_sheet(channels)
    back = decode_sheet(sheet.encoded)
    for one in fields(GroundSheet):
        np.testing.assert_array_equal(getattr(back, one.name), getattr(sheet, one.name), err_msg=one.name)
    assert back.digest == sheet.digest


def test_a_sheet_of_no_cells_reads_back() -> None:
    assert decode_sheet(a_sheet(rows=0, columns=0).encoded).height_mm.shape == (0, 0)


def test_heights_are_metres_and_unknown_ones_are_nan() -> None:
    sheet = a_sheet()
    assert np.isnan(sheet.height[0, 0])
    assert sheet.height[3, 2] == pytest.approx(int(sheet.height_mm[3, 2]) / 1000.0)
    np.testing.assert_allclose(sheet.corner_m, [-0.3, 1.2])


def test_the_label_of_a_cell_is_the_class_with_the_most_votes() -> None:
    votes = np.zeros((1, 4, 3), np.uint16)
    votes[0, 1, 1] = votes[0, 2, 0] = votes[0, 2, 2] = 4
    votes[0, 3] = 1, 2, 60000
    sheet = replace(a_sheet(rows=1, columns=4), votes=votes)
    assert sheet.label.tolist() == [[255, 1, 0, 9]]


def test_damage_is_named_with_the_file_and_the_remedy() -> None:
    data = a_sheet().encoded
    for bad in (data[:-1], b"WLSUBMAP" + data[8:], data[:-4] + b"\x00\x00\x00\x00", b""):
        with pytest.raises(InputError, match=r"x\.ground.*run the stage ground again"):
            decode_sheet(bad, "x.ground")


def test_rasters_that_do_not_fit_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="the colour is"):
        replace(a_sheet(), colour=np.zeros((3, 3, 3), np.uint8))
