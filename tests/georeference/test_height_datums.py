"""Fixes whose heights alone lie apart: their places count, and the height says what it does not know."""

import numpy as np
import pytest

from wayloom.evaluation.gnss_drives import PLACE, MadeDrive, Receiver, city_way, made_drive
from wayloom.georeference.alignment import georeference
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import GeoReference, Wanted
from wayloom.georeference.uncertainty import position_covariance


def shifted_from(share: float, shift_enu_m: tuple[float, float, float], seed: int = 0) -> tuple[MadeDrive, GeoReference]:
    drive = made_drive(city_way(60.0), Receiver(shift_from=share, shift_enu_m=shift_enu_m), seed)
    return drive, georeference(drive.log, drive.odometry)  # type: ignore[arg-type]


def errors_and_sigmas(drive: MadeDrive, geo: GeoReference) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) m each, east, north, up."""
    assert geo.frame is not None
    variance = np.diagonal(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2)
    return geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3], np.sqrt(variance)


@pytest.mark.parametrize("seed", [0, 1])
def test_fixes_of_another_height_keep_their_places_and_only_the_height_is_in_doubt(seed: int) -> None:
    drive, geo = shifted_from(0.5, (0.0, 0.0, 13.0), seed)
    error, sigma = errors_and_sigmas(drive, geo)
    assert geo.report["fixes"]["rejected"] == 0
    assert np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()) < 0.05
    assert sigma[:, :2].max() < 0.2
    assert sigma[:, 2].min() > 5.0  # the other half says that all lies 13 m higher
    assert any("heights of the fixes change once and for all" in message for message in geo.report["messages"])


def test_a_height_that_a_fifth_of_the_fixes_has_is_found_and_tells_its_size() -> None:
    drive, geo = shifted_from(0.8, (0.0, 0.0, 0.5))
    error, sigma = errors_and_sigmas(drive, geo)
    [datum] = geo.report["height_datums"]
    assert datum["from_s"] == pytest.approx(48.0, abs=0.5)
    assert datum["higher_m"] == pytest.approx(0.5, abs=0.1)
    assert (np.abs(error) < 4.0 * sigma).all()
    assert sigma.max() < 0.3


def test_fixes_that_lie_apart_in_their_places_too_are_left_out() -> None:
    _, geo = shifted_from(0.5, (1.2, -0.9, 13.0))
    assert geo.report["height_datums"] == []
    assert geo.report["fixes"]["rejected"] == 300


def test_fixes_of_one_height_have_no_other_datum() -> None:
    drive = made_drive(city_way(60.0), Receiver(), 0)
    geo = georeference(drive.log, drive.odometry)  # type: ignore[arg-type]
    assert geo.report["height_datums"] == []


def test_heights_all_off_by_as_much_are_in_the_sigma_where_the_settings_say_so() -> None:
    drive = made_drive(city_way(30.0), Receiver(), 0)
    plain, wide = (
        georeference(drive.log, drive.odometry, Wanted(PLACE), GeoReferenceSettings(height_datum_sigma_m=sigma_m))  # type: ignore[arg-type]
        for sigma_m in (0.0, 3.0)
    )
    assert np.array_equal(plain.T_enu_cam, wide.T_enu_cam)
    _, narrow = errors_and_sigmas(drive, plain)
    _, with_datum = errors_and_sigmas(drive, wide)
    assert np.allclose(with_datum[:, 2], np.hypot(narrow[:, 2], 3.0), rtol=1e-3)
    assert np.allclose(with_datum[:, :2], narrow[:, :2], rtol=1e-2)
