"""Drives beyond the reach of a map's origin, refused before anything is made of them."""

import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.logs.types import GnssTrack
from wayloom.pipeline.settings import WayloomSettings
from wayloom_workers.map_reach import check_reach

KARLSRUHE = (8.4, 49.0, 115.0)


def fixes(*lon_lat: tuple[float, float]) -> GnssTrack:
    count = len(lon_lat)
    places = np.array([(lon, lat, 115.0) for lon, lat in lon_lat]).reshape(-1, 3)
    return GnssTrack(np.arange(count), places, np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.uint8))


def test_a_drive_of_another_country_is_told_how_far_it_is_and_what_to_do() -> None:
    with pytest.raises(InputError, match="GNSS") as caught:
        check_reach(fixes((2.35, 48.86), (2.36, 48.86)), WayloomSettings(map_origin=KARLSRUHE))
    assert "44" in str(caught.value)  # 441 km to the nearer fix
    assert "WAYLOOM_MAP_ORIGIN" in str(caught.value)


@pytest.mark.parametrize(
    ("gnss", "origin"),
    [
        (fixes((8.41, 49.01)), KARLSRUHE),
        (fixes((2.35, 48.86), (8.41, 49.01)), KARLSRUHE),
        (fixes((2.35, 48.86)), None),
        (fixes(), KARLSRUHE),
        (None, KARLSRUHE),
    ],
    ids=["near", "one fix near", "origin follows the drives", "no fix", "no gnss"],
)
def test_whatever_may_yet_be_in_reach_goes_on(gnss: GnssTrack | None, origin: tuple[float, float, float] | None) -> None:
    check_reach(gnss, WayloomSettings(map_origin=origin))
