"""The file of a drive's places gives back what was written, and anything else is refused by name."""

import numpy as np
import pytest

from places.made_places import random_places
from wayloom.errors import InputError
from wayloom.places.files import encode_places, load_places, save_places


def test_places_come_back_as_they_were_but_for_the_packing(tmp_path):
    places = random_places(1)
    save_places(places, tmp_path / "drive.places")
    back = load_places(tmp_path / "drive.places")
    np.testing.assert_array_equal(back.T_world_keyframe, places.T_world_keyframe)
    np.testing.assert_array_equal(back.segment, places.segment)
    assert back.camera == places.camera
    for name in ("keyframe", "bits", "sigma_m"):
        np.testing.assert_array_equal(getattr(back.features, name), getattr(places.features, name))
    np.testing.assert_allclose(back.features.uv, places.features.uv, atol=0.5 / 16 + 1e-4)
    for name in ("keyframe", "p_cam", "label", "sigma_cm"):
        np.testing.assert_array_equal(getattr(back.cloud, name), getattr(places.cloud, name))


def test_a_feature_comes_back_on_its_ray(tmp_path):
    places = random_places(2)
    save_places(places, tmp_path / "drive.places")
    back = load_places(tmp_path / "drive.places").features
    inside = (places.features.uv < 4000).all(axis=1) & (places.features.p_cam[:, :2] > 0).all(axis=1)
    # Half a step of 1/16 px at 30 m and 200 px of focal length is 5 mm.
    np.testing.assert_allclose(back.p_cam[inside], places.features.p_cam[inside], atol=0.006)


def test_written_again_it_has_the_same_bytes():
    assert encode_places(random_places(3)) == encode_places(random_places(3))


@pytest.mark.parametrize("cut", [3, 20, 400, -5])
def test_a_damaged_file_is_refused_by_name(tmp_path, cut):
    path = tmp_path / "drive.places"
    path.write_bytes(encode_places(random_places(4))[:cut])
    with pytest.raises(InputError, match=r"drive\.places"):
        load_places(path)


def test_a_missing_file_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(InputError, match="run the stage places again"):
        load_places(tmp_path / "drive.places")
