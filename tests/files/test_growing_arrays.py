from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.files import growing_arrays
from wayloom.files.growing_arrays import GrowingArray, GrowingTable, forget_pages


@pytest.mark.parametrize("limit", [0, 100, 10_000])
def test_a_growing_array_is_the_same_in_memory_and_in_a_file(limit: int) -> None:
    growing, rows = GrowingArray(np.float32, (2,), limit), []
    for n in (0, 3, 1, 40):
        rows.append(np.random.default_rng(n).random((n, 2)))
        growing.append(rows[-1])
    rows[-1][:] = 0.0  # what was appended is a copy
    expected = np.concatenate([*rows[:-1], np.random.default_rng(40).random((40, 2))]).astype(np.float32)
    np.testing.assert_array_equal(growing.array(), expected)
    assert len(growing) == 44
    assert (growing.file is None) == (limit == 10_000)


def test_an_empty_growing_array_keeps_its_type_and_shape() -> None:
    assert GrowingArray(np.int32, (3,)).array().shape == (0, 3)


def test_pages_that_are_forgotten_are_read_again() -> None:
    grown = GrowingArray(np.float64, (2,), in_memory_bytes=100)
    rows = np.arange(20_000.0).reshape(-1, 2)
    grown.append(rows)
    in_file, in_memory = grown.array(), rows.copy()
    for array in (in_file, in_file[3:], in_memory):
        before = array.copy()
        forget_pages(array)
        np.testing.assert_array_equal(array, before)


def test_a_full_disk_is_told_with_the_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(prefix: str) -> IO[bytes]:
        return Path("/dev/full").open("r+b", buffering=64)

    monkeypatch.setattr(growing_arrays.tempfile, "TemporaryFile", full)
    grown = GrowingArray(np.uint8, in_memory_bytes=0)
    with pytest.raises(OSError, match="No space left") as told:
        grown.append(np.zeros(1000, np.uint8))
    assert told.value.filename == growing_arrays.tempfile.gettempdir()
    few = GrowingArray(np.uint8, in_memory_bytes=0)
    few.append(np.zeros(10, np.uint8))  # less than what a file holds back
    with pytest.raises(OSError, match="No space left") as told:
        few.array()
    assert told.value.filename == growing_arrays.tempfile.gettempdir()


@dataclass(frozen=True)
class Places:
    number: NDArray[np.int32]
    at: NDArray[np.float32]


@pytest.mark.parametrize("limit", [0, 1_000_000])
def test_a_growing_table_has_the_rows_of_its_parts_and_no_part_no_row(limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_arrays, "IN_MEMORY_BYTES", limit)
    grown = GrowingTable(Places(np.zeros(0, np.int32), np.zeros((0, 2), np.float32)))
    assert grown.table().at.shape == (0, 2)
    parts = [Places(np.arange(n, dtype=np.int32), np.random.default_rng(n).random((n, 2), np.float32)) for n in (3, 0, 5)]
    for part in parts:
        grown.append(part)
    table = grown.table()
    np.testing.assert_array_equal(table.number, np.concatenate([part.number for part in parts]))
    np.testing.assert_array_equal(table.at, np.concatenate([part.at for part in parts]))
    assert (table.number.dtype, table.at.dtype) == (np.int32, np.float32)
