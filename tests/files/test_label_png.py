"""Label images as PNG: what any reader decodes is what was written."""

import cv2
import numpy as np
import pytest

from wayloom.files.label_png import encode_label_png


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (37, 53), (376, 1241)])
def test_what_another_reader_decodes_is_what_was_written(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, shape).astype(np.uint8)
    flat = np.asarray(cv2.resize(rng.integers(0, 19, (4, 6)).astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST))
    for image in (noise, flat, np.asfortranarray(noise), noise[::-1]):
        decoded = cv2.imdecode(np.frombuffer(encode_label_png(image), np.uint8), cv2.IMREAD_UNCHANGED)
        assert decoded.dtype == np.uint8
        assert np.array_equal(decoded, image)


def test_areas_of_one_label_take_few_bytes() -> None:
    labels = np.zeros((376, 1241), np.uint8)
    labels[200:, :600] = 13
    assert len(encode_label_png(labels)) < 0.01 * labels.size
