"""Image files: headers without decoding, and decoding with checks."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from wayloom.errors import LogError
from wayloom.logs.images.image_files import FilesOf, ImageHeader, ImagePairs, list_images, read_header, read_image

COLOURS = np.random.default_rng(0).integers(0, 256, (30, 50, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".ppm", ".webp"])
def test_a_colour_picture_is_read_in_rgb_whatever_its_format(tmp_path: Path, suffix: str) -> None:
    smooth = cv2.resize(COLOURS[::10, ::10], (50, 30), interpolation=cv2.INTER_CUBIC)
    file = tmp_path / f"a{suffix}"
    cv2.imwrite(str(file), smooth[..., ::-1])
    assert read_header(file) == ImageHeader(50, 30, True)
    got = read_image(file, colour=True)
    assert np.abs(got.astype(int) - smooth).mean() < (0.01 if suffix in (".png", ".bmp", ".tif", ".ppm") else 12)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm"])
def test_a_grey_picture_is_grey(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"a{suffix}"
    cv2.imwrite(str(file), COLOURS[..., 0])
    assert read_header(file) == ImageHeader(50, 30, False)
    assert read_image(file, colour=False).shape == (30, 50)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0, 1, 5, 20, 30, 100, -200, -20, -3])
def test_a_truncated_picture_is_refused_by_header_and_by_decoder(tmp_path: Path, suffix: str, keep: int) -> None:
    file = tmp_path / f"a{suffix}"
    cv2.imwrite(str(file), COLOURS)
    file.write_bytes(file.read_bytes()[:keep])
    for read in (read_header, lambda file: read_image(file, colour=True)):
        with pytest.raises(LogError, match=str(file)):
            read(file)


def test_any_damage_inside_a_png_is_found(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    cv2.imwrite(str(file), COLOURS)
    whole = file.read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.integers(8, len(whole), 60):
        data = bytearray(whole)
        data[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(data)
        with pytest.raises(LogError):
            read_image(file, colour=True)


def test_images_are_listed_by_number_and_other_files_are_passed_over(tmp_path: Path) -> None:
    for name in ("10.png", "9.png", "0000000011.jpg", "notes.txt", ".hidden.png", "Thumbs.db"):
        (tmp_path / name).write_bytes(b"")
    assert list(list_images(tmp_path)) == ["9", "10", "0000000011"]


def test_files_of_a_folder_are_paths_by_row_and_slice_and_can_be_chosen(tmp_path: Path) -> None:
    left, right = (FilesOf(tmp_path / side, ("1.png", "2.png", "3.png")) for side in ("left", "right"))
    assert left[-1] == tmp_path / "left" / "3.png"
    assert list(left[1:]) == [tmp_path / "left" / "2.png", tmp_path / "left" / "3.png"]
    kept = ImagePairs((1, 2, 3), left, right).kept([2, 0])
    assert (kept.numbers, [file.name for file in kept.left]) == ((3, 1), ["3.png", "1.png"])
    assert list(kept.right) == [right[2], right[0]]


def test_files_have_names_from_a_folder_that_they_are_in_and_none_from_another(tmp_path: Path) -> None:
    files = FilesOf(tmp_path / "left", ("1.png", "2.png"))
    assert files.inside(tmp_path) == ["left/1.png", "left/2.png"]
    assert files.inside(tmp_path / "left") == ["1.png", "2.png"]
    assert files.inside(tmp_path / "other") == []
