import numpy as np

from wayloom.files.blob import blob_pieces, decode_blob, encode_blob

MAGIC = b"WLTESTED"


def test_pieces_are_the_bytes_and_hold_no_copy_of_an_array() -> None:
    arrays = {
        "bits": np.arange(5, dtype=np.uint8), "none": np.zeros((0, 3), "<i2"), "flags": np.array([True, False]),
        "rows": np.arange(12.0).reshape(3, 4), "halves": np.arange(3, dtype="<f2"),
    }  # fmt: skip
    data = encode_blob(MAGIC, 2, {"kind": "tested"}, arrays)
    pieces = list(blob_pieces(MAGIC, 2, {"kind": "tested"}, arrays))
    assert b"".join(pieces) == data
    assert any(np.shares_memory(np.frombuffer(piece, np.uint8), arrays["rows"]) for piece in pieces if len(piece) == 96)
    header, back = decode_blob(data, MAGIC, 2, {name: array.dtype.str for name, array in arrays.items()})
    assert header == {"kind": "tested"}
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].shape == array.shape


def test_numbers_of_another_byte_order_and_columns_first_are_stored_as_all_are() -> None:
    rows = np.arange(12.0).reshape(3, 4)
    assert encode_blob(MAGIC, 1, {}, {"rows": np.asfortranarray(rows.astype(">f8"))}) == encode_blob(MAGIC, 1, {}, {"rows": rows})
