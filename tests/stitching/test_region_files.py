"""Regions come back from their bytes, and nothing else is taken for one."""

import numpy as np
import pytest

from stitching.comparison import assert_identical
from stitching.made_walls import street_submap
from submaps.made_submaps import FRAME
from wayloom.errors import InputError
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.region_files import decode_region, encode_region
from wayloom.stitching.region_grid import regions_within
from wayloom.stitching.regions import fuse_region, regions_of

STREET = [street_submap(seed) for seed in range(3)]


def test_a_region_comes_back_from_its_bytes_with_all_of_its_layers() -> None:
    for key in sorted(regions_of(STREET[0])):
        region = fuse_region(key, STREET)
        back = decode_region(encode_region(region, FRAME))
        assert back.key == key
        for layer in LAYERS:
            assert_identical(back.layers[layer], region.layers[layer])
        assert encode_region(back, FRAME) == encode_region(region, FRAME)


@pytest.mark.parametrize("damage", [lambda d: d[:60], lambda d: d[:-1], lambda d: b"", lambda d: b"WLPOINTS" + d[8:]])
def test_damaged_regions_are_refused(damage) -> None:
    data = encode_region(fuse_region((0, 0), []), FRAME)
    with pytest.raises(InputError, match="is no region"):
        decode_region(damage(data))


def test_the_regions_of_a_box_are_at_least_those_of_the_submap_in_it() -> None:
    for item in STREET:
        flat = item.points_enu()[:, :2]
        assert regions_of(item) <= set(regions_within(flat.min(axis=0), flat.max(axis=0)))
        assert len(set(regions_within(flat.min(axis=0), flat.max(axis=0)))) < 60


def test_a_region_without_submaps_is_empty() -> None:
    region = fuse_region((3, -2), [])
    assert {len(layer) for layer in region.layers.values()} == {0}
    assert np.shape(region.layers["static"].votes) == (0, 19)
