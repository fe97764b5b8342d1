"""Object sightings: bytes there and back, damage, shapes, raster of looks, folder."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from objects.made_sightings import some_sightings
from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.objects.files import load_one, read_index, save_all, sightings_file
from wayloom.objects.types import ObjectSightings, decode_sightings


@pytest.mark.parametrize("count", [0, 3])
def test_sightings_read_back_as_they_were_written(count: int) -> None:
    sightings = some_sightings(np.arange(3.0 * count).reshape(count, 3))
    back = decode_sightings(sightings.encoded)
    for one in fields(ObjectSightings):
        np.testing.assert_array_equal(getattr(back, one.name), getattr(sightings, one.name), err_msg=one.name)
    assert back.digest == sightings.digest


def test_damage_is_named_with_the_file_and_the_remedy() -> None:
    data = some_sightings([[0.0, 1.0, 2.0]]).encoded
    for bad in (data[:-1], b"WLSUBMAP" + data[8:], data + b"\0", b"", data[:20]):
        with pytest.raises(InputError, match=r"x\.objects.*run the stage objects again"):
            decode_sightings(bad, "x.objects")


def test_columns_that_do_not_fit_each_other_are_refused() -> None:
    sightings = some_sightings([[0.0, 1.0, 2.0]])
    with pytest.raises(ValueError, match="covariance is"):
        replace(sightings, covariance=np.zeros((2, 3, 3), np.float32))
    with pytest.raises(ValueError, match="a kind 7"):
        replace(sightings, kind=np.array([7], np.uint8))
    with pytest.raises(ValueError, match="no raster"):
        replace(sightings, looked=np.zeros(4, np.uint8))


def test_looks_are_counted_in_the_level_frame() -> None:
    looked = np.zeros((4, 6), np.uint8)
    looked[1, 5] = 7
    T_submap_level = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))
    sightings = replace(some_sightings([]), looked=looked, corner=np.array([10, 20], np.int32), T_submap_level=T_submap_level)
    level = np.array([[7.7, 10.6, 3.0], [7.7, 10.4, 0.0], [0.0, 0.0, 0.0]])  # column 15, row 21; a row lower; outside
    assert sightings.looked_at(se3.transform(T_submap_level, level)).tolist() == [7, 0, 0]


def test_a_folder_keeps_the_order_of_the_road(tmp_path: Path) -> None:
    parts = [some_sightings([[float(k), 0.0, 0.0]], name=f"submap {k}") for k in range(3)]
    save_all(parts, tmp_path)
    assert read_index(tmp_path) == {f"submap {k}": parts[k].digest for k in range(3)}
    np.testing.assert_array_equal(load_one(tmp_path, parts[1].digest).position, parts[1].position)


def test_what_is_missing_or_not_what_its_name_says_is_refused(tmp_path: Path) -> None:
    one, other = some_sightings([[0.0, 0.0, 0.0]]), some_sightings([[1.0, 0.0, 0.0]])
    with pytest.raises(InputError, match="no index"):
        read_index(tmp_path)
    save_all([one], tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        load_one(tmp_path, other.digest)
    sightings_file(tmp_path, other.digest).write_bytes(one.encoded)
    with pytest.raises(InputError, match="not hold what its name says"):
        load_one(tmp_path, other.digest)
