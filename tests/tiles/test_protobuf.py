import mapbox_vector_tile

from wayloom.files.wire_format import varint
from wayloom.tiles import protobuf


def test_small_numbers_with_sign_stay_short():
    assert [protobuf.zigzag(n) for n in (0, -1, 1, -2)] == [b"\x00", b"\x01", b"\x02", b"\x03"]
    assert protobuf.zigzag(2147483647) == varint(4294967294)


def test_the_specifications_own_example_of_a_polygon_is_met():
    """Section 4.3.5.5's ring is drawn with MoveTo 1 (9), LineTo (26 for three points), ClosePath (15)."""
    assert list(protobuf.square(3, 6, 5)) == [9, 6, 12, 26, 10, 0, 0, 10, 9, 0, 15]


def test_a_reader_of_others_gets_back_what_was_written():
    squares = [(protobuf.square(32 * i, 64 * i, 32), {"class": f"é {i % 3}", "count": 10**i}) for i in range(12)]
    tracks = [(protobuf.line([(-64, 5), (4096, 5), (0, 4160)]), {"drive": "a"})]
    data = protobuf.layer("cells", 4096, protobuf.POLYGON, squares) + protobuf.layer("tracks", 4096, protobuf.LINE, tracks)
    read = mapbox_vector_tile.decode(data, default_options={"y_coord_down": True})
    assert read["cells"]["version"] == 2
    assert read["cells"]["extent"] == 4096
    for i, feature in enumerate(read["cells"]["features"]):
        assert feature["properties"] == {"class": f"é {i % 3}", "count": 10**i}
        x, y = 32 * i, 64 * i
        ring = feature["geometry"]["coordinates"][0]
        assert {tuple(p) for p in ring} == {(x, y), (x + 32, y), (x + 32, y + 32), (x, y + 32)}
        assert ring[0] == ring[-1]
    assert [tuple(p) for p in read["tracks"]["features"][0]["geometry"]["coordinates"]] == [(-64, 5), (4096, 5), (0, 4160)]


def test_numbers_of_all_kinds_and_equal_values_keep_their_types():
    told = [{"width": 0.12, "count": 1}, {"width": 1.0, "count": 1}, {"width": 1.0, "count": 2, "kind": "1"}]
    data = protobuf.layer("lines", 4096, protobuf.LINE, [(protobuf.line([(0, 0), (1, 1)]), one) for one in told])
    read = [one["properties"] for one in mapbox_vector_tile.decode(data)["lines"]["features"]]
    assert read == told
    assert [[type(value) for value in one.values()] for one in read] == [[type(value) for value in one.values()] for one in told]
