"""Cloud-optimised GeoTIFFs: read back by another reader, and laid out as they must be."""

import struct

import cv2
import numpy as np
import pytest

from wayloom.files.geotiff import TILE, GeoGrid, write_cog
from wayloom.ground.exports import halved_colours, halved_heights

EMPTY = np.zeros((TILE, TILE, 4), np.uint8)


def directories(data):
    """The directories of a BigTIFF: of each, tag to values."""
    sizes = {2: ("c", 1), 3: ("H", 2), 4: ("I", 4), 12: ("d", 8), 16: ("Q", 8)}
    order, version, _, _, at = struct.unpack_from("<2sHHHQ", data)
    assert (order, version) == (b"II", 43)
    out = []
    while at:
        (count,) = struct.unpack_from("<Q", data, at)
        tags = {}
        for k in range(count):
            tag, kind, n = struct.unpack_from("<HHQ", data, at + 8 + 20 * k)
            code, size = sizes[kind]
            place = at + 8 + 20 * k + 12
            if n * size > 8:
                (place,) = struct.unpack_from("<Q", data, place)
            tags[tag] = struct.unpack_from(f"<{n}{code}", data, place)
        assert list(tags) == sorted(tags)
        out.append(tags)
        (at,) = struct.unpack_from("<Q", data, at + 8 + 20 * count)
    return out


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(4)
    image = cv2.GaussianBlur(rng.integers(0, 256, (900, 1300, 4)).astype(np.uint8), (0, 0), 6)
    image[..., 3] = 255
    image[:512, :512] = 0
    return image


@pytest.fixture(scope="module")
def file(picture, tmp_path_factory):
    padded = np.zeros((1024, 1536, 4), np.uint8)
    padded[:900, :1300] = picture

    def tile_at(row, column):
        tile = padded[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE]
        return tile if tile.any() else None

    path = tmp_path_factory.mktemp("tif") / "ground.tif"
    write_cog(path, GeoGrid(457789.3, 5428858.5, 0.05, 1300, 900, 32632), tile_at, EMPTY, halved_colours)
    return path


def test_another_reader_sees_the_picture(file, picture):
    read = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read[..., [2, 1, 0, 3]], picture)


def test_the_overviews_halve_until_one_tile_holds_all(file):
    assert [(tags[256][0], tags[257][0]) for tags in directories(file.read_bytes())] == [(1300, 900), (650, 450), (325, 225)]


def test_directories_come_first_and_the_smallest_overview_before_the_picture(file):
    tables = directories(file.read_bytes())
    first = [min(tags[324]) for tags in tables]
    assert first == sorted(first, reverse=True)
    assert min(first) > 16 + 20 * sum(len(tags) for tags in tables)


def test_pixels_lie_where_the_grid_says(file):
    tags = directories(file.read_bytes())[0]
    assert tags[33550][:2] == (0.05, 0.05)
    assert tags[33922][3:5] == (457789.3, 5428858.5)
    keys = np.array(tags[34735]).reshape(-1, 4)
    assert {1024: 1, 1025: 1, 3072: 32632}.items() <= dict(zip(keys[1:, 0].tolist(), keys[1:, 3].tolist(), strict=True)).items()


def test_heights_are_floats_with_nan_for_nothing(tmp_path):
    tile = np.full((TILE, TILE), np.nan, np.float32)
    tile[3, 5] = 12.25
    write_cog(
        tmp_path / "h.tif", GeoGrid(0.0, 0.0, 0.1, 512, 512, None), lambda r, c: tile, np.full_like(tile, np.nan), halved_heights
    )
    read = cv2.imread(str(tmp_path / "h.tif"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, tile)
    tags = directories((tmp_path / "h.tif").read_bytes())[0]
    assert b"".join(tags[42113]) == b"nan\0"
    assert dict(np.array(tags[34735]).reshape(-1, 4)[1:, [0, 3]].tolist())[1024] == 32767


def test_equal_content_is_equal_bytes(file, picture, tmp_path):
    padded = np.zeros((1024, 1536, 4), np.uint8)
    padded[:900, :1300] = picture
    again = tmp_path / "again.tif"
    grid = GeoGrid(457789.3, 5428858.5, 0.05, 1300, 900, 32632)

    def tile_at(row, column):
        tile = padded[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE]
        return tile if tile.any() else None

    write_cog(again, grid, tile_at, EMPTY, halved_colours)
    assert again.read_bytes() == file.read_bytes()


def test_what_does_not_show_darkens_no_overview():
    tile = np.zeros((2, 2, 4), np.uint8)
    tile[0, 0] = 200, 100, 50, 255
    np.testing.assert_array_equal(halved_colours(tile)[0, 0], [200, 100, 50, 64])
    np.testing.assert_allclose(halved_heights(np.array([[np.nan, 2.0], [4.0, np.nan]], np.float32)), [[3.0]])
