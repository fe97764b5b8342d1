"""Protocol buffers' wire format, written and read back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayloom.files.wire_format import BYTES, VARINT, field, number_field, records, varint


@pytest.mark.parametrize(("value", "data"), [(0, b"\x00"), (127, b"\x7f"), (128, b"\x80\x01"), (300, b"\xac\x02")])
def test_numbers_are_written_as_the_wire_format_says(value: int, data: bytes) -> None:
    assert varint(value) == data


@given(st.lists(st.tuples(st.integers(1, 2**29 - 1), st.one_of(st.integers(0, 2**64 - 1), st.binary(max_size=300))), max_size=20))
def test_records_come_back_as_they_were_written(written: list[tuple[int, int | bytes]]) -> None:
    data = b"".join(number_field(n, v) if isinstance(v, int) else field(n, v) for n, v in written)
    found = [(n, low if kind == VARINT else data[low:high]) for n, kind, low, high in records(data, 0, len(data))]
    assert found == written


@pytest.mark.parametrize("data", [b"\x80", b"\x0a\x05abc", b"\x0b", b"\x02\x00", b"\x08" + b"\xff" * 11, bytes([1 << 3 | 1, 0])])
def test_what_is_no_record_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"varint|record|wire type"):
        list(records(data, 0, len(data)))


def test_records_of_eight_and_of_four_bytes_have_their_place() -> None:
    data = bytes([1 << 3 | 1]) + bytes(8) + bytes([2 << 3 | 5]) + bytes(4) + field(3, b"x")
    assert list(records(data, 0, len(data))) == [(1, 1, 1, 9), (2, 5, 10, 14), (3, BYTES, 16, 17)]
