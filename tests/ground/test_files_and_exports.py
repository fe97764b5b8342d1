"""Folders of ground sheets, and the GeoTIFFs of a drive."""

import struct

import cv2
import numpy as np
import pytest

from made_ground import KERB_AT_M, KERB_M, MadeStreet, grey_at
from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.exports import HEIGHT_FILE, ORTHOPHOTO_FILE, export_ground
from wayloom.ground.files import load_sheet, read_index, save_sheets
from wayloom.ground.making import make_sheets
from wayloom.ground.sheet import NO_HEIGHT, GroundSheet
from wayloom.submaps.submap import PlacedSubmap


@pytest.fixture(scope="module")
def street():
    return MadeStreet()


@pytest.fixture(scope="module")
def submaps(street):
    return street.submaps(2)


@pytest.fixture(scope="module")
def folder(street, submaps, tmp_path_factory):
    out = tmp_path_factory.mktemp("ground")
    save_sheets(make_sheets(street, street.odometry(), street, submaps), out)
    return out


def corner(path):
    """West, north and pixel size as the file's tags 33922 and 33550 say."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<Q", data, 16)
    found = {}
    for k in range(count):
        tag, _, _, place = struct.unpack_from("<HHQQ", data, 24 + 20 * k)
        found[tag] = place
    west, north = struct.unpack_from("<2d", data, found[33922] + 24)
    return west, north, struct.unpack_from("<d", data, found[33550])[0]


def test_a_folder_gives_back_its_sheets_by_submap(folder, submaps):
    index = read_index(folder)
    assert list(index) == [item.submap.digest for item in submaps]
    for submap, digest in index.items():
        sheet = load_sheet(folder, digest)
        assert (sheet.submap, sheet.digest) == (submap, digest)


def test_a_sheet_that_is_damaged_or_missing_is_told_by_its_file(folder, tmp_path):
    (digest, *_) = read_index(folder).values()
    data = (folder / f"{digest}.ground").read_bytes()
    (tmp_path / f"{digest}.ground").write_bytes(data[:-1])
    with pytest.raises(InputError, match=r"does not hold what its name says"):
        load_sheet(tmp_path, digest)
    with pytest.raises(InputError, match=r"cannot be read"):
        load_sheet(tmp_path, "0" * 64)
    with pytest.raises(InputError, match=r"no index of ground sheets"):
        read_index(tmp_path)


def test_the_geotiffs_of_a_drive_without_gnss_lie_in_its_own_frame(folder, submaps, tmp_path):
    export_ground(folder, submaps, tmp_path)
    photo = cv2.imread(str(tmp_path / ORTHOPHOTO_FILE), cv2.IMREAD_UNCHANGED)
    height = cv2.imread(str(tmp_path / HEIGHT_FILE), cv2.IMREAD_UNCHANGED)
    west, north, pixel = corner(tmp_path / HEIGHT_FILE)
    assert pixel == pytest.approx(0.1)
    assert not np.isinf(height).any()
    cells = sum(np.isfinite(load_sheet(folder, digest).height).sum() for digest in read_index(folder).values())
    assert 0.5 * cells < np.isfinite(height).sum() <= 1.05 * cells
    r, c = np.nonzero(np.isfinite(height))
    x, y, z = west + (c + 0.5) * 0.1, north - (r + 0.5) * 0.1, height[r, c]
    near = (y > 8.0) & (y < 18.0)
    assert np.median(np.abs(z[near & (np.abs(x) < 2.5)])) < 0.01
    assert np.median(z[near & (x > KERB_AT_M + 0.3) & (x < KERB_AT_M + 0.8)]) == pytest.approx(KERB_M, abs=0.02)
    west, north, pixel = corner(tmp_path / ORTHOPHOTO_FILE)
    assert pixel == pytest.approx(0.05)
    r, c = np.nonzero(photo[..., 3])
    x, y = west + (c + 0.5) * 0.05, north - (r + 0.5) * 0.05
    here = (np.abs(x) < 2.5) & (y > 8.0) & (y < 14.0)
    shown, true = photo[r[here], c[here], 0].astype(float), grey_at(x[here], y[here]).ravel()
    assert np.corrcoef(shown**2, true)[0, 1] > 0.75


def test_the_geotiffs_of_a_placed_drive_lie_in_utm_at_their_place(folder, submaps, tmp_path):
    frame = MapFrame(8.5, 49.5, 0.0)
    away = np.eye(4)
    away[:3, 3] = 20000.0, -30000.0, 210.0
    placed = [PlacedSubmap(item.submap, away @ item.T_enu_submap, np.eye(6), "drive", frame) for item in submaps]
    export_ground(folder, placed, tmp_path)
    height = cv2.imread(str(tmp_path / HEIGHT_FILE), cv2.IMREAD_UNCHANGED)
    west, north, _ = corner(tmp_path / HEIGHT_FILE)
    enu = np.column_stack([np.zeros(5), np.linspace(9.0, 13.0, 5), np.zeros(5)]) + away[:3, 3]
    told = wgs84.utm_from_lonlatheight(wgs84.lonlatheight_from_enu(enu, frame), 32632)
    r, c = np.floor((north - told[:, 1]) / 0.1).astype(int), np.floor((told[:, 0] - west) / 0.1).astype(int)
    np.testing.assert_allclose(height[r, c], told[:, 2], atol=0.03)


def test_heights_stand_where_a_sheet_has_them_and_nowhere_else(submaps, tmp_path):
    sheets = [a_plane(submaps[0].submap.digest, 5000, 0), a_plane(submaps[1].submap.digest, 7000, 60)]
    save_sheets(sheets, tmp_path)
    level = [PlacedSubmap(item.submap, np.eye(4), np.eye(6), "drive", None) for item in submaps]
    export_ground(tmp_path, level, tmp_path)
    height = cv2.imread(str(tmp_path / HEIGHT_FILE), cv2.IMREAD_UNCHANGED)
    found, counts = np.unique(height[~np.isnan(height)], return_counts=True)
    assert dict(zip(found.tolist(), counts.tolist(), strict=True)) == {5.0: 40 * 50 - 100, 7.0: 40 * 50 - 100}


def a_plane(submap: str, height_mm: int, column: int) -> GroundSheet:
    """40 x 50 cells of one height with a hole of 10 x 10."""
    height = np.full((40, 50), height_mm, np.int16)
    height[10:20, 10:20] = NO_HEIGHT
    return GroundSheet(
        submap, np.eye(4), np.array([column, 0], np.int32), np.zeros(2, np.int64), height,
        np.where(height == NO_HEIGHT, 0, 9).astype(np.uint8), np.ones((40, 50, 3), np.uint16),
        np.full((80, 100, 1), 90, np.uint8), np.full((80, 100), 9, np.uint8),
    )  # fmt: skip


def test_a_drive_without_ground_leaves_no_geotiff(submaps, tmp_path):
    save_sheets([], tmp_path / "none")
    export_ground(tmp_path / "none", submaps, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["none"]
